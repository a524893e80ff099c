const NAMES = ["ink", "muted", "line", "soft", "paper", "blue", "orange", "green", "pink"];
export function colours() {
    const style = getComputedStyle(document.documentElement);
    return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}
export class Canvas {
    element;
    paint;
    context;
    width = 0;
    height = 0;
    asked = false;
    watch;
    dark = matchMedia("(prefers-color-scheme: dark)");
    constructor(element, paint) {
        this.element = element;
        this.paint = paint;
        this.context = element.getContext("2d");
        this.watch = new ResizeObserver(() => this.fit());
        this.watch.observe(element);
        this.dark.addEventListener("change", this.redraw);
    }
    end() {
        this.watch.disconnect();
        this.dark.removeEventListener("change", this.redraw);
    }
    redraw = () => {
        if (this.asked)
            return;
        this.asked = true;
        requestAnimationFrame(() => {
            this.asked = false;
            if (this.width > 0)
                this.now();
        });
    };
    fit() {
        const ratio = window.devicePixelRatio || 1, { clientWidth, clientHeight } = this.element;
        this.width = clientWidth;
        this.height = clientHeight;
        this.element.width = Math.round(ratio * clientWidth);
        this.element.height = Math.round(ratio * clientHeight);
        if (clientWidth > 0)
            this.now();
    }
    now() {
        const ratio = this.element.width / this.width;
        this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
        this.context.clearRect(0, 0, this.width, this.height);
        this.context.font = "12px system-ui, sans-serif";
        this.context.lineJoin = this.context.lineCap = "round";
        this.paint(this, colours());
    }
}
export const WIDE = 48, HIGH = 28;
export function ticks(low, high, pixels, least) {
    const rough = (high - low) * Math.min(Math.max(pixels / 8, least), 90) / pixels, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= 0.999 * rough);
    const found = [];
    for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-9) + 1e-12; i++)
        found.push(Number((i * step).toPrecision(12)));
    return found;
}
export function logTicks(low, high) {
    const factors = Math.log10(high / low) > 2.2 ? [1] : [1, 2, 5], first = Math.floor(Math.log10(low)), found = [];
    for (let power = first; 10 ** power <= high; power++)
        found.push(...factors.map((one) => Number((one * 10 ** power).toPrecision(3))));
    return found.filter((one) => one >= low && one <= high);
}
export function trace(context, points, closed = false) {
    context.beginPath();
    points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
    if (closed)
        context.closePath();
}
export function arrow(context, from, to, tint, wide) {
    const [dx, dy] = [to[0] - from[0], to[1] - from[1]], size = Math.hypot(dx, dy);
    if (size < 1)
        return;
    const head = Math.min(4 * wide, 0.6 * size), [ux, uy] = [dx / size, dy / size];
    const neck = [to[0] - 0.85 * head * ux, to[1] - 0.85 * head * uy];
    context.strokeStyle = context.fillStyle = tint;
    context.lineWidth = wide;
    trace(context, [from, neck]);
    context.stroke();
    trace(context, [to, [to[0] - head * ux - 0.5 * head * uy, to[1] - head * uy + 0.5 * head * ux],
        [to[0] - head * ux + 0.5 * head * uy, to[1] - head * uy - 0.5 * head * ux]], true);
    context.fill();
}
export function label(context, words, x, y, tint, paper) {
    const room = context.canvas.width / context.getTransform().a, wide = context.measureText(words).width;
    const left = x - wide * ({ right: 1, center: 0.5 }[context.textAlign] ?? 0);
    x += Math.max(Math.min(left, room - wide - 4), 4) - left;
    context.lineWidth = 3.5;
    context.strokeStyle = paper;
    context.strokeText(words, x, y);
    context.fillStyle = tint;
    context.fillText(words, x, y);
}
