export function h(name, attributes = {}, ...children) {
    const node = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
        if (typeof value === "function")
            node.addEventListener(key, value);
        else if (key === "value" && "value" in node)
            node.value = String(value);
        else if (typeof value === "boolean")
            node.toggleAttribute(key, value);
        else if (value !== null && value !== undefined)
            node.setAttribute(key, String(value));
    }
    node.append(...children.filter((one) => one !== null && one !== false && one !== undefined));
    return node;
}
export function digits(value, count = 3) {
    if (value === null || value === undefined || !Number.isFinite(value))
        return "–";
    const rounded = Number(value.toPrecision(count)), size = Math.abs(rounded);
    if (size === 0)
        return "0";
    if (size < 1e-4 || size >= 1e6)
        return value.toExponential(count - 1);
    return rounded.toFixed(Math.max(count - 1 - Math.floor(Math.log10(size)), 0)).replace("-", "−");
}
export function fixed(value, places) {
    if (!Number.isFinite(value))
        return "–";
    const text = value.toFixed(places);
    return (Number(text) === 0 ? text.replace("-", "") : text).replace("-", "−");
}
export function coded(text) {
    return text.split("`").map((part, i) => i % 2 ? h("code", {}, part) : document.createTextNode(part));
}
export function commandLine() {
    const code = h("code"), button = h("button", { type: "button", class: "quiet", click: copy }, "copy");
    async function copy() {
        await navigator.clipboard.writeText(code.textContent ?? "");
        button.textContent = "copied";
        setTimeout(() => { button.textContent = "copy"; }, 1200);
    }
    const element = h("div", { class: "command" }, h("span", { "aria-hidden": "true" }, "$"), code, button);
    return { element, set: (text) => { code.textContent = text; element.hidden = text === ""; } };
}
