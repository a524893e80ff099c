// A plain text with numbered lines, which are folded where they are long; lines in which something is wrong are marked.
import { h } from "./dom.js";

export interface Mistake { line: number; text: string }

export class Editor {
  readonly element: HTMLElement;
  private readonly area = h("textarea", { spellcheck: "false", autocapitalize: "off", autocomplete: "off", "aria-label": "recording.toml" });
  private readonly numbers = h("div", { class: "numbers", "aria-hidden": "true" });
  private readonly under = h("div", { class: "under-text", "aria-hidden": "true" });  // the same lines, unseen: how high each is folded
  private mistakes: Mistake[] = [];
  private readonly watch = new ResizeObserver(() => this.place());

  constructor(changed: () => void) {
    this.element = h("div", { class: "code" }, this.numbers, h("div", { class: "sheet" }, this.under, this.area));
    this.area.addEventListener("input", () => { this.number(); changed(); });
    this.area.addEventListener("scroll", () => this.follow());
    this.watch.observe(this.area);
  }

  end(): void {
    this.watch.disconnect();
  }

  get text(): string {
    return this.area.value;
  }

  set text(value: string) {
    if (value === this.area.value) return;
    this.area.value = value;
    this.number();
  }

  mark(mistakes: Mistake[]): void {
    this.mistakes = mistakes;
    this.area.setAttribute("aria-invalid", String(mistakes.length > 0));
    this.number();
  }

  // The line as a whole, selected and in sight.
  go(line: number): void {
    const rows = this.area.value.split("\n"), from = rows.slice(0, line - 1).reduce((sum, row) => sum + row.length + 1, 0);
    this.area.focus();
    this.area.setSelectionRange(from, from + (rows[line - 1]?.length ?? 0));
    const above = this.under.children[Math.max(0, line - 4)] as HTMLElement | undefined;
    this.area.scrollTop = (above?.offsetTop ?? 0) - (this.under.firstElementChild as HTMLElement).offsetTop;
  }

  private number(): void {
    const wrong = new Map(this.mistakes.map((one) => [one.line, one.text])), rows = this.area.value.split("\n");
    this.under.replaceChildren(...rows.map((row, i) => h("p", { class: wrong.has(i + 1) ? "wrong" : "" }, row || "\u200b")));
    this.numbers.replaceChildren(h("div", {}, ...rows.map((_, i) => h("span", { class: wrong.has(i + 1) ? "wrong" : "", title: wrong.get(i + 1) ?? null }, String(i + 1)))));
    this.place();
  }

  // Each number beside the first row of its line.
  private place(): void {
    this.under.style.width = `${this.area.clientWidth}px`;
    const heights = [...this.under.children].map((row) => (row as HTMLElement).offsetHeight), spans = this.numbers.querySelectorAll("span");
    spans.forEach((span, i) => { span.style.height = `${heights[i]}px`; });
    this.follow();
  }

  private follow(): void {
    for (const one of [this.under, this.numbers.firstElementChild as HTMLElement | null]) one?.style.setProperty("transform", `translateY(${-this.area.scrollTop}px)`);
  }
}
