import { h } from "./dom.js";
export class Editor {
    element;
    area = h("textarea", { spellcheck: "false", autocapitalize: "off", autocomplete: "off", "aria-label": "recording.toml" });
    numbers = h("div", { class: "numbers", "aria-hidden": "true" });
    under = h("div", { class: "under-text", "aria-hidden": "true" });
    mistakes = [];
    watch = new ResizeObserver(() => this.place());
    constructor(changed) {
        this.element = h("div", { class: "code" }, this.numbers, h("div", { class: "sheet" }, this.under, this.area));
        this.area.addEventListener("input", () => { this.number(); changed(); });
        this.area.addEventListener("scroll", () => this.follow());
        this.watch.observe(this.area);
    }
    end() {
        this.watch.disconnect();
    }
    get text() {
        return this.area.value;
    }
    set text(value) {
        if (value === this.area.value)
            return;
        this.area.value = value;
        this.number();
    }
    mark(mistakes) {
        this.mistakes = mistakes;
        this.area.setAttribute("aria-invalid", String(mistakes.length > 0));
        this.number();
    }
    go(line) {
        const rows = this.area.value.split("\n"), from = rows.slice(0, line - 1).reduce((sum, row) => sum + row.length + 1, 0);
        this.area.focus();
        this.area.setSelectionRange(from, from + (rows[line - 1]?.length ?? 0));
        const above = this.under.children[Math.max(0, line - 4)];
        this.area.scrollTop = (above?.offsetTop ?? 0) - this.under.firstElementChild.offsetTop;
    }
    number() {
        const wrong = new Map(this.mistakes.map((one) => [one.line, one.text])), rows = this.area.value.split("\n");
        this.under.replaceChildren(...rows.map((row, i) => h("p", { class: wrong.has(i + 1) ? "wrong" : "" }, row || "\u200b")));
        this.numbers.replaceChildren(h("div", {}, ...rows.map((_, i) => h("span", { class: wrong.has(i + 1) ? "wrong" : "", title: wrong.get(i + 1) ?? null }, String(i + 1)))));
        this.place();
    }
    place() {
        this.under.style.width = `${this.area.clientWidth}px`;
        const heights = [...this.under.children].map((row) => row.offsetHeight), spans = this.numbers.querySelectorAll("span");
        spans.forEach((span, i) => { span.style.height = `${heights[i]}px`; });
        this.follow();
    }
    follow() {
        for (const one of [this.under, this.numbers.firstElementChild])
            one?.style.setProperty("transform", `translateY(${-this.area.scrollTop}px)`);
    }
}
