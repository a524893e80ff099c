import { h } from "./dom.js";
export class Editor {
    element;
    area = h("textarea", { spellcheck: "false", autocapitalize: "off", autocomplete: "off", wrap: "off", "aria-label": "recording.toml" });
    numbers = h("div", { class: "numbers", "aria-hidden": "true" });
    bars = h("div", { class: "bars", "aria-hidden": "true" });
    mistakes = [];
    watch = new ResizeObserver(() => this.place());
    constructor(changed) {
        this.element = h("div", { class: "code" }, this.numbers, h("div", { class: "sheet" }, this.bars, this.area));
        this.area.addEventListener("input", () => { this.number(); changed(); });
        this.area.addEventListener("scroll", () => this.place());
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
        this.area.scrollTop = Math.max(0, (line - 4) * this.height);
    }
    get height() {
        return parseFloat(getComputedStyle(this.area).lineHeight);
    }
    number() {
        const wrong = new Set(this.mistakes.map((one) => one.line)), count = this.area.value.split("\n").length;
        this.numbers.replaceChildren(h("div", {}, ...Array.from({ length: count }, (_, i) => h("span", { class: wrong.has(i + 1) ? "wrong" : "" }, String(i + 1)))));
        this.bars.replaceChildren(...[...wrong].map((line) => h("i", { "data-line": line, title: this.mistakes.find((one) => one.line === line).text })));
        this.place();
    }
    place() {
        const { scrollTop } = this.area, pad = parseFloat(getComputedStyle(this.area).paddingTop);
        this.numbers.firstElementChild?.style.setProperty("transform", `translateY(${-scrollTop}px)`);
        for (const bar of this.bars.querySelectorAll("i"))
            bar.style.transform = `translateY(${pad + (Number(bar.dataset.line) - 1) * this.height - scrollTop}px)`;
    }
}
