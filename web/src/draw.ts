// A canvas as sharp as the screen, in the page's own colours, and axes in round numbers.

export type Point = [number, number];
export interface Colours {
  ink: string; muted: string; line: string; soft: string; paper: string; blue: string; orange: string; green: string; pink: string;
}

const NAMES = ["ink", "muted", "line", "soft", "paper", "blue", "orange", "green", "pink"] as const;

export function colours(): Colours {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()])) as unknown as Colours;
}

// Draws once for each frame of the screen that something changed in; also when size or colours change.
export class Canvas {
  readonly context: CanvasRenderingContext2D;
  width = 0;
  height = 0;
  private asked = false;
  private readonly watch: ResizeObserver;
  private readonly dark = matchMedia("(prefers-color-scheme: dark)");

  constructor(readonly element: HTMLCanvasElement, private readonly paint: (canvas: Canvas, tint: Colours) => void) {
    this.context = element.getContext("2d")!;
    this.watch = new ResizeObserver(() => this.fit());
    this.watch.observe(element);
    this.dark.addEventListener("change", this.redraw);
  }

  end(): void {
    this.watch.disconnect();
    this.dark.removeEventListener("change", this.redraw);
  }

  readonly redraw = (): void => {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      if (this.width > 0) this.now();
    });
  };

  private fit(): void {
    const ratio = window.devicePixelRatio || 1, { clientWidth, clientHeight } = this.element;
    this.width = clientWidth;
    this.height = clientHeight;
    this.element.width = Math.round(ratio * clientWidth);
    this.element.height = Math.round(ratio * clientHeight);
    if (clientWidth > 0) this.now();
  }

  private now(): void {
    const ratio = this.element.width / this.width;
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, this.width, this.height);
    this.context.font = "12px system-ui, sans-serif";
    this.context.lineJoin = this.context.lineCap = "round";
    this.paint(this, colours());
  }
}

// Round numbers from low to high, which so many pixels show: the fewer these are the closer, but `least` apart.
export const WIDE = 48, HIGH = 28;  // px, of a number with air around it
export function ticks(low: number, high: number, pixels: number, least: number): number[] {
  const rough = (high - low) * Math.min(Math.max(pixels / 8, least), 90) / pixels, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= 0.999 * rough)!;
  const found: number[] = [];
  for (let i = Math.ceil(low / step); i * step <= high * (1 + 1e-9) + 1e-12; i++) found.push(Number((i * step).toPrecision(12)));
  return found;
}

// The same on a logarithmic axis: powers of ten, and where those are few 2 and 5 times them.
export function logTicks(low: number, high: number): number[] {
  const factors = Math.log10(high / low) > 2.2 ? [1] : [1, 2, 5], first = Math.floor(Math.log10(low)), found: number[] = [];
  for (let power = first; 10 ** power <= high; power++) found.push(...factors.map((one) => Number((one * 10 ** power).toPrecision(3))));
  return found.filter((one) => one >= low && one <= high);
}

export function trace(context: CanvasRenderingContext2D, points: Point[], closed = false): void {
  context.beginPath();
  points.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  if (closed) context.closePath();
}

export function arrow(context: CanvasRenderingContext2D, from: Point, to: Point, tint: string, wide: number): void {
  const [dx, dy] = [to[0] - from[0], to[1] - from[1]], size = Math.hypot(dx, dy);
  if (size < 1) return;
  const head = Math.min(4 * wide, 0.6 * size), [ux, uy] = [dx / size, dy / size];
  const neck: Point = [to[0] - 0.85 * head * ux, to[1] - 0.85 * head * uy];
  context.strokeStyle = context.fillStyle = tint;
  context.lineWidth = wide;
  trace(context, [from, neck]);
  context.stroke();
  trace(context, [to, [to[0] - head * ux - 0.5 * head * uy, to[1] - head * uy + 0.5 * head * ux],
    [to[0] - head * ux + 0.5 * head * uy, to[1] - head * uy - 0.5 * head * ux]], true);
  context.fill();
}

// Text that stands before lines: with the paper's colour around it, and moved inwards where the picture would cut it.
export function label(context: CanvasRenderingContext2D, words: string, x: number, y: number, tint: string, paper: string): void {
  const room = context.canvas.width / context.getTransform().a, wide = context.measureText(words).width;
  const left = x - wide * ({ right: 1, center: 0.5 }[context.textAlign as string] ?? 0);
  x += Math.max(Math.min(left, room - wide - 4), 4) - left;
  context.lineWidth = 3.5;
  context.strokeStyle = paper;
  context.strokeText(words, x, y);
  context.fillStyle = tint;
  context.fillText(words, x, y);
}
