// The film's first frame, with the tags that were found in it and those that recording.toml names.
import { digits, h } from "./dom.js";
import { Canvas, Colours, Point, trace } from "./draw.js";
import { post } from "./net.js";

export interface Tag { id: number; base: boolean; s: number | null }
interface Frame { width: number; height: number; picture: string; tags: { id: number; corners: Point[] }[] }

export class FirstFrame {
  readonly element: HTMLElement;
  private readonly node = h("canvas", { role: "img", "aria-label": "the film's first frame with the tags that were found" });
  private readonly words = h("figcaption", {});
  private readonly canvas: Canvas;
  private readonly picture = new Image();
  private frame: Frame | null = null;
  private tags: Tag[] = [];
  private asked = 0;
  private strange: number[] = [];
  private readonly use = h("button", { type: "button", hidden: true, click: () => this.wanted(this.strange) }, "Use these tags");

  constructor(private readonly wanted: (ids: number[]) => void) {
    this.element = h("figure", { class: "first" }, this.node, this.words, this.use);
    this.canvas = new Canvas(this.node, this.paint);
    this.picture.addEventListener("load", this.canvas.redraw);
    this.clear();
  }

  end(): void {
    this.canvas.end();
  }

  clear(): void {
    this.asked += 1;
    this.frame = null;
    this.node.hidden = this.use.hidden = true;
    this.words.textContent = "";
  }

  none(): void {
    this.clear();
    this.words.textContent = "This recording has no film.";
  }

  async load(name: string, file: string, topic: string, family: string): Promise<void> {
    const mine = ++this.asked;
    this.words.textContent = "Looking for tags in the first frame …";
    try {
      const frame = await post<Frame>("/api/recordings/frame", { name, file, topic, family });
      if (mine !== this.asked) return;
      this.frame = frame;
      this.picture.src = frame.picture;
      this.node.style.aspectRatio = `${frame.width} / ${frame.height}`;
      this.node.hidden = false;
      this.say();
    } catch (error) {
      if (mine !== this.asked) return;
      this.clear();
      this.words.textContent = (error as Error).message;
    }
  }

  expect(tags: Tag[]): void {
    this.tags = tags;
    this.say();
  }

  private say(): void {
    if (!this.frame) return;
    const seen = this.frame.tags.map((one) => one.id), named = this.tags.map((one) => one.id), ids = (list: number[]): string => [...new Set(list)].sort((a, b) => a - b).join(", ");
    const missing = named.filter((id) => !seen.includes(id)), strange = this.strange = [...new Set(seen.filter((id) => !named.includes(id)))].sort((a, b) => a - b);
    const parts = [seen.length ? `Tags in the first frame: ${ids(seen)}.` : "No tag in the first frame."];
    if (missing.length) parts.push(`Not found: ${ids(missing)}.`);
    if (strange.length) parts.push(`Not in recording.toml: ${ids(strange)}.`);
    this.words.textContent = parts.join(" ");
    this.words.classList.toggle("warning", missing.length > 0);
    this.use.hidden = !strange.length;
    this.canvas.redraw();
  }

  private readonly paint = ({ context, width }: Canvas, tint: Colours): void => {
    if (!this.frame || !this.picture.complete) return;
    const scale = width / this.frame.width;
    context.drawImage(this.picture, 0, 0, width, this.frame.height * scale);
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "center";
    for (const { id, corners } of this.frame.tags) {
      const tag = this.tags.find((one) => one.id === id), points = corners.map(([x, y]): Point => [x * scale, y * scale]);
      const colour = !tag ? "#b3558b" : tag.base ? "#0072b2" : "#007a5a", words = !tag ? `${id}?` : tag.base ? `${id} base` : tag.s === null ? `${id}` : `${id} s=${digits(tag.s, 2)}`;
      for (const [wide, line] of [[5, "#fff"], [2.5, colour]] as const) {
        context.lineWidth = wide;
        context.strokeStyle = line;
        trace(context, points, true);
        context.stroke();
      }
      const x = points.reduce((sum, one) => sum + one[0], 0) / 4, low = Math.max(...points.map((one) => one[1]));
      context.lineWidth = 4;
      context.strokeStyle = "#fff";
      context.strokeText(words, x, low + 15);
      context.fillStyle = colour;
      context.fillText(words, x, low + 15);
    }
    context.strokeStyle = tint.line;
  };
}
