// The film of a recording, frame by frame, with the beam as fitted, the tags as measured and the force over it.
import { digits, h } from "./dom.js";
import { arrow, Canvas, Colours, Point, trace } from "./draw.js";

interface Frame {
  picture: string; frame: number; time_s: number; beam_px: Point[]; band_px: Point[]; tags_px: Point[]; arrow_px: [Point, Point]; force_N: Point;
}
export interface Film { width: number; height: number; frames: Frame[] }

export class FilmView {
  readonly element: HTMLElement;
  private readonly node = h("canvas", { "aria-label": "a frame of the film" });
  private readonly slider = h("input", { type: "range", min: 0, value: 0, step: 1, "aria-label": "frame" });
  private readonly words = h("p", { class: "reading", "aria-live": "polite" });
  private readonly play = h("button", { type: "button", "aria-label": "play", click: () => this.run() }, "▶");
  private readonly pictures = new Map<number, HTMLImageElement>();
  private readonly canvas: Canvas;
  private film: Film | null = null;
  private timer = 0;

  constructor(private readonly moved: (frame: number) => void) {
    this.element = h("figure", { class: "film", hidden: true }, this.node, h("div", { class: "under" }, this.play, this.slider), this.words,
      h("figcaption", {}, "The beam as fitted (its pale band: all of k(s) that is probable), the tags as measured, the force."));
    this.canvas = new Canvas(this.node, this.paint);
    this.slider.addEventListener("input", () => { this.stop(); this.show(); });
  }

  end(): void {
    this.stop();
    this.canvas.end();
  }

  set(film: Film | null, at: number | null): void {
    this.stop();
    this.film = film;
    this.pictures.clear();
    this.element.hidden = !film || !film.frames.length;
    if (!film) return;
    this.slider.max = String(film.frames.length - 1);
    const sizes = film.frames.map(({ force_N }) => Math.hypot(...force_N)), known = film.frames.findIndex(({ frame }) => frame === at);
    this.slider.value = String(known >= 0 ? known : sizes.indexOf(Math.max(...sizes)));
    this.node.style.aspectRatio = `${film.width} / ${film.height}`;
    this.node.style.maxWidth = `${Math.max(film.width, 320) * 1.4}px`;
    this.show();
  }

  private show(): void {
    const one = this.film!.frames[this.slider.valueAsNumber]!;
    this.words.textContent = `frame ${one.frame} · ${one.time_s.toFixed(2)} s · F = (${digits(one.force_N[0])}, ${digits(one.force_N[1])}) N, ${digits(Math.hypot(...one.force_N))} N as fitted`;
    this.moved(one.frame);
    this.canvas.redraw();
  }

  private run(): void {
    if (this.timer) return this.stop();
    this.play.textContent = "❚❚";
    this.timer = window.setInterval(() => {
      this.slider.value = String((this.slider.valueAsNumber + 1) % this.film!.frames.length);
      this.show();
    }, 120);
  }

  private stop(): void {
    window.clearInterval(this.timer);
    this.timer = 0;
    this.play.textContent = "▶";
  }

  private picture(i: number): HTMLImageElement {
    let found = this.pictures.get(i);
    if (!found) {
      found = new Image();
      found.addEventListener("load", this.canvas.redraw);
      found.src = this.film!.frames[i]!.picture;
      this.pictures.set(i, found);
    }
    return found;
  }

  private readonly paint = ({ context, width }: Canvas, tint: Colours): void => {
    if (!this.film) return;
    const i = this.slider.valueAsNumber, one = this.film.frames[i]!, picture = this.picture(i), scale = width / this.film.width;
    context.scale(scale, scale);
    if (picture.complete) context.drawImage(picture, 0, 0, this.film.width, this.film.height);
    trace(context, one.band_px, true);
    context.fillStyle = "#56b4e9";
    context.globalAlpha = 0.4;
    context.fill();
    context.globalAlpha = 1;
    for (const [wide, colour] of [[5, "#fff"], [2.5, "#0072b2"]] as const) {
      context.lineWidth = wide;
      context.strokeStyle = colour;
      trace(context, one.beam_px);
      context.stroke();
    }
    for (const [wide, colour] of [[4, "#fff"], [2, tint.orange]] as const) {
      context.lineWidth = wide;
      context.strokeStyle = colour;
      for (const [x, y] of one.tags_px) {
        context.beginPath();
        context.arc(x, y, 7, 0, 2 * Math.PI);
        context.stroke();
      }
    }
    arrow(context, one.arrow_px[0], one.arrow_px[1], "#fff", 6);
    arrow(context, one.arrow_px[0], one.arrow_px[1], tint.orange, 3);
  };
}
