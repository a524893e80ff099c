// Elements made from text alone: nothing that a file says is ever read as HTML.

export type Child = Node | string | null | false | undefined;
type Attributes = Record<string, string | number | boolean | null | undefined | ((event: never) => void)>;

export function h<K extends keyof HTMLElementTagNameMap>(
  name: K, attributes: Attributes = {}, ...children: Child[]
): HTMLElementTagNameMap[K] {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (typeof value === "function") node.addEventListener(key, value as EventListener);
    else if (key === "value" && "value" in node) (node as HTMLInputElement).value = String(value);
    else if (typeof value === "boolean") node.toggleAttribute(key, value);
    else if (value !== null && value !== undefined) node.setAttribute(key, String(value));
  }
  node.append(...children.filter((one): one is Node | string => one !== null && one !== false && one !== undefined));
  return node;
}

// A number as an engineer writes it: so many digits that count.
export function digits(value: number | null | undefined, count = 3): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  const rounded = Number(value.toPrecision(count)), size = Math.abs(rounded);
  if (size === 0) return "0";
  if (size < 1e-4 || size >= 1e6) return value.toExponential(count - 1);
  return rounded.toFixed(Math.max(count - 1 - Math.floor(Math.log10(size)), 0)).replace("-", "−");
}

// So many places behind the point, with a proper minus: for numbers that change while one looks.
export function fixed(value: number, places: number): string {
  if (!Number.isFinite(value)) return "–";
  const text = value.toFixed(places);
  return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}

// What stands between backticks as code.
export function coded(text: string): Node[] {
  return text.split("`").map((part, i) => i % 2 ? h("code", {}, part) : document.createTextNode(part));
}

// The command line that does the same, to be copied.
export function commandLine(): { element: HTMLElement; set: (text: string) => void } {
  const code = h("code"), button = h("button", { type: "button", class: "quiet", click: copy }, "copy");
  async function copy(): Promise<void> {
    await navigator.clipboard.writeText(code.textContent ?? "");
    button.textContent = "copied";
    setTimeout(() => { button.textContent = "copy"; }, 1200);
  }
  const element = h("div", { class: "command" }, h("span", { "aria-hidden": "true" }, "$"), code, button);
  return { element, set: (text) => { code.textContent = text; element.hidden = text === ""; } };
}
