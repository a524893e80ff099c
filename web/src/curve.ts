// k(s) with its 95 % band: of one result in full, of several one over the other.
import { digits, h } from "./dom.js";
import { Canvas, Colours, HIGH, label, logTicks, Point, ticks, trace } from "./draw.js";

export interface Band { level: number; low_N_m: number[]; high_N_m: number[] }
export interface Curve { s: number[]; k_N_m: number[]; bands: Band[]; identified?: boolean[]; doubts?: string[] }
export interface Shown { name: string; curve: Curve; length_m: number; tags: number[] }

const TINTS = ["blue", "orange", "green", "pink"] as const;
export const tintOf = (i: number): (typeof TINTS)[number] => TINTS[i % TINTS.length]!;

export class CurveView {
  readonly element: HTMLElement;
  readonly log = h("input", { type: "checkbox", change: () => this.canvas.redraw() });
  readonly canvas: Canvas;
  private readonly node = h("canvas", { tabindex: 0, role: "slider", "aria-label": "k(s); the arrow keys move along the beam", "aria-valuemin": 0, "aria-valuemax": 1 });
  private readonly words = h("p", { class: "reading", "aria-live": "polite" });
  private shown: Shown[] = [];
  private s = 0.5;

  constructor() {
    this.element = h("figure", { class: "curve" }, this.node, h("div", { class: "under" }, this.words, h("label", { class: "check" }, this.log, "logarithmic")));
    this.canvas = new Canvas(this.node, this.paint);
    const point = (event: PointerEvent): void => {
      if (event.type === "pointermove" && event.pointerType === "mouse" ? false : event.type === "pointermove" && event.buttons === 0) return;
      const box = this.node.getBoundingClientRect();
      this.to((event.clientX - box.left - 56) / (box.width - 72));
    };
    this.node.addEventListener("pointermove", point);
    this.node.addEventListener("pointerdown", point);
    this.node.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: -0.01, ArrowRight: 0.01, Home: -1, End: 1 }[event.key];
      if (step === undefined) return;
      this.to(this.s + step);
      event.preventDefault();
    });
  }

  set(shown: Shown[]): void {
    this.shown = shown;
    this.to(this.s);
  }

  private to(s: number): void {
    this.s = Math.min(Math.max(s, 0), 1);
    this.words.replaceChildren(...this.shown.flatMap((one, i) => this.reading(one, i)));
    this.node.setAttribute("aria-valuenow", this.s.toFixed(2));
    this.node.setAttribute("aria-valuetext", this.words.textContent ?? "");
    this.canvas.redraw();
  }

  private reading({ name, curve, length_m }: Shown, i: number): Node[] {
    const at = Math.round(this.s * (curve.s.length - 1)), band = curve.bands[0], known = curve.identified?.[at] ?? true;
    const words = [`s = ${this.s.toFixed(2)} (${digits(1000 * length_m * this.s)} mm)`, `k = ${digits(curve.k_N_m[at])} N m`];
    if (band) words.push(`95 %: ${digits(band.low_N_m[at])} to ${digits(band.high_N_m[at])}`);
    if (!known) words.push(curve.doubts?.length ? "not to be trusted" : "not identified");
    const line = h("span", { class: "line" }, this.shown.length > 1 && h("i", { class: tintOf(i) }), this.shown.length > 1 ? `${name}: ` : "", words.join(" · "));
    return [line];
  }

  private range(): [number, number] {
    const top: number[] = [], low: number[] = [];
    for (const { curve } of this.shown) {
      curve.k_N_m.forEach((k, i) => {
        const known = curve.identified?.[i] ?? true, band = curve.bands[0];
        top.push(known && band ? band.high_N_m[i]! : k);
        low.push(known && band ? band.low_N_m[i]! : k);
      });
    }
    const most = 1.1 * Math.max(...top, 1e-12);
    return this.log.checked ? [0.8 * Math.min(...low.filter((one) => one > 0)), most] : [Math.min(0, ...low), most];
  }

  private readonly paint = ({ context, width, height }: Canvas, tint: Colours): void => {
    if (!this.shown.length) return;
    const [left, right, top, bottom] = [56, width - 16, 14, height - 40], [low, high] = this.range(), log = this.log.checked;
    const scale = (k: number): number => log ? Math.log(Math.max(k, 1e-3 * low)) : k;
    const x = (s: number): number => left + s * (right - left);
    const y = (k: number): number => bottom - (bottom - top) * (scale(k) - scale(low)) / (scale(high) - scale(low));
    this.axes(context, tint, [left, right, top, bottom], [low, high], x, y);
    context.save();
    context.beginPath();
    context.rect(left, top, right - left, bottom - top);
    context.clip();
    this.shown.forEach((one, i) => this.curve(context, tint, one.curve, tint[tintOf(i)], x, y));
    context.restore();
    for (const place of this.shown[0]!.tags) {
      context.fillStyle = tint.ink;
      context.beginPath();
      context.arc(x(place), bottom, 4, 0, 2 * Math.PI);
      context.fill();
    }
    context.strokeStyle = tint.muted;
    context.lineWidth = 1;
    context.setLineDash([2, 3]);
    trace(context, [[x(this.s), top], [x(this.s), bottom]]);
    context.stroke();
    context.setLineDash([]);
    this.shown.forEach(({ curve }, i) => {
      const k = curve.k_N_m[Math.round(this.s * (curve.s.length - 1))]!;
      context.beginPath();
      context.arc(x(this.s), y(k), 5, 0, 2 * Math.PI);
      context.fillStyle = tint[tintOf(i)];
      context.fill();
      context.strokeStyle = tint.paper;
      context.lineWidth = 2;
      context.stroke();
    });
  };

  private axes(context: CanvasRenderingContext2D, tint: Colours, [left, right, top, bottom]: number[], [low, high]: [number, number],
    x: (s: number) => number, y: (k: number) => number): void {
    const marks = this.log.checked && high / low > 5 ? logTicks(low, high) : ticks(low, high, bottom! - top!, HIGH);
    context.strokeStyle = tint.line;
    context.fillStyle = tint.muted;
    context.lineWidth = 1;
    context.textAlign = "right";
    for (const k of marks) {
      trace(context, [[left!, y(k)], [right!, y(k)]]);
      context.stroke();
      context.fillText(digits(k, 2), left! - 8, y(k) + 4);
    }
    context.textAlign = "center";
    for (const s of [0, 0.2, 0.4, 0.6, 0.8, 1]) {
      trace(context, [[x(s), top!], [x(s), bottom!]]);
      context.stroke();
      context.fillText(s.toFixed(1), x(s), bottom! + 18);
    }
    context.fillText("place along the beam s; dots: the tags", 0.5 * (left! + right!), bottom! + 35);
    context.textAlign = "left";
    label(context, "k [N m]", left! + 6, top! + 12, tint.muted, tint.paper);
  }

  // Grey where k is known to no better than a factor of 1.5.
  private curve(context: CanvasRenderingContext2D, tint: Colours, curve: Curve, colour: string, x: (s: number) => number, y: (k: number) => number): void {
    const known = curve.identified ?? curve.s.map(() => true), last = curve.s.length - 1, alone = this.shown.length === 1;
    for (let from = 0; from < last;) {
      let end = from + 1;
      while (end < last && known[end] === known[from]) end++;
      const places = [...Array(end - from + 1).keys()].map((i) => from + i);
      const along = (values: number[]): Point[] => places.map((i) => [x(curve.s[i]!), y(values[i]!)]);
      context.fillStyle = context.strokeStyle = known[from] ? colour : tint.muted;
      for (const band of alone ? curve.bands : curve.bands.slice(0, 1)) {
        context.globalAlpha = 0.16;
        trace(context, [...along(band.high_N_m), ...along(band.low_N_m).reverse()], true);
        context.fill();
      }
      context.globalAlpha = 1;
      context.lineWidth = 2.2;
      trace(context, along(curve.k_N_m));
      context.stroke();
      from = end;
    }
  }
}
