// The plane of bending: axes, reachable set and its edge, beam, ellipse, force, and what is held.
import { arrow, Canvas, Colours, label, Point, ticks, trace, WIDE } from "./draw.js";
import { digits, fixed } from "./dom.js";
import { drawEdge, drawReach, Limit, ReachMap } from "./reach.js";

export interface Opened {
  model: string; length_m: number; rest_m: Point[]; push_s: number; point_s: number; max_force_N: number;
  largest_first_N: number; mode: "point" | "hand"; doubts: string[]; band: boolean; version: number;
}
export interface Ellipse { outline_m: Point[]; semi_axes_m: Point; draws: number; lost: number }
export interface Answer {
  goal_m: Point; pose: [number, number, number]; force_N: Point; moment_N_m: number; push_m: Point; line_m: Point[];
  ellipse: Ellipse | null; limit: Limit; away_m: number; turned_away_rad: number; margin: number; bend_per_m: number; command: string; beyond_learned: number;
  seconds: number; version: number;
}
export interface Scene {
  opened: Opened | null; answer: Answer | null; map: ReachMap | null; edge: [Point, Limit][] | null;
  goal: Point | null; held: boolean; focus: boolean;
}

// Near the edge of stability some of the probable beams fall: an ellipse says nothing of where they lie then.
export function telling(ellipse: Ellipse, opened: Opened): boolean {
  return ellipse.lost < 0.01 && ellipse.semi_axes_m[0] < 0.25 * opened.length_m;
}

const KNOB = 52;  // px from the hand to what turns it

export class Plane {
  private scale = 1;
  private origin: Point = [0, 0];
  private readonly still = document.createElement("canvas");  // what a drag does not change
  private drawn = "";
  private drawnMap: ReachMap | null = null;

  readonly paint = (canvas: Canvas, tint: Colours): void => {
    const { context, width, height } = canvas, { opened, answer, map } = this.scene;
    if (!opened) return;
    this.fit(canvas, opened);
    const ratio = canvas.element.width / width, now = `${width} ${height} ${ratio} ${tint.paper} ${opened.version} ${opened.model}`;
    if (now !== this.drawn || map !== this.drawnMap) {
      [this.drawn, this.drawnMap] = [now, map];
      [this.still.width, this.still.height] = [canvas.element.width, canvas.element.height];
      const below = this.still.getContext("2d")!;
      below.setTransform(ratio, 0, 0, ratio, 0, 0);
      below.font = context.font;
      this.axes(below, width, height, tint);
      if (opened.mode === "point" && map) drawReach(below, tint, this.px, map);
    }
    context.drawImage(this.still, 0, 0, width, height);
    if (opened.mode === "hand") this.handsReach(context, tint);
    this.clamp(context, tint);
    context.strokeStyle = tint.muted;
    context.lineWidth = 1;
    context.setLineDash([5, 4]);
    trace(context, opened.rest_m.map(this.px));
    context.stroke();
    context.setLineDash([]);
    if (answer) this.bent(context, tint, opened, answer);
  };

  constructor(readonly scene: Scene) {}

  readonly px = ([x, y]: Point): Point => [this.origin[0] + this.scale * x, this.origin[1] - this.scale * y];
  readonly metres = ([x, y]: Point): Point => [(x - this.origin[0]) / this.scale, (this.origin[1] - y) / this.scale];

  knob(): Point | null {
    const { opened, answer } = this.scene;
    if (!opened || opened.mode !== "hand" || !answer) return null;
    const [x, y, angle] = answer.pose, at = this.px([x, y]);
    return [at[0] + KNOB * Math.cos(angle), at[1] - KNOB * Math.sin(angle)];
  }

  private fit({ width, height }: Canvas, { length_m: L }: Opened): void {
    const side = this.scene.opened!.mode === "hand" ? 1.05 : 0.75;
    let [left, right, low, high] = [-0.12 * L, 1.06 * L, -side * L, side * L];
    if (this.scene.map && this.scene.opened!.mode === "point") {
      for (const [x, y] of this.scene.map.points_m) {
        [left, right, low, high] = [Math.min(left, x), Math.max(right, x), Math.min(low, y), Math.max(high, y)];
      }
    }
    const room: [number, number] = [width - 64, height - 56];
    this.scale = Math.min(room[0] / (right - left), room[1] / (high - low));
    this.origin = [42 + 0.5 * room[0] - 0.5 * this.scale * (left + right), 22 + 0.5 * room[1] + 0.5 * this.scale * (low + high)];
  }

  private axes(context: CanvasRenderingContext2D, width: number, height: number, tint: Colours): void {
    const [left, high] = this.metres([0, 0]), [right, low] = this.metres([width, height]);
    const step = ticks(left, right, width, WIDE), apart = (step[1] ?? 1) - (step[0] ?? 0);
    context.strokeStyle = tint.line;
    context.lineWidth = 1;
    context.fillStyle = tint.muted;
    context.textAlign = "center";
    context.textBaseline = "alphabetic";
    for (const x of step) {
      const at = Math.round(this.px([x, 0])[0]) + 0.5;
      trace(context, [[at, 0], [at, height]]);
      context.stroke();
      if (at > 50 && at < width - 62) context.fillText(fixed(1000 * x, apart < 0.001 ? 1 : 0), at, height - 6);
    }
    context.textAlign = "right";
    for (let i = Math.ceil(low / apart); i * apart <= high; i++) {
      const at = Math.round(this.px([0, i * apart])[1]) + 0.5;
      trace(context, [[0, at], [width, at]]);
      context.stroke();
      if (at > 24 && at < height - 26) context.fillText(fixed(1000 * i * apart, apart < 0.001 ? 1 : 0), 38, at + 4);
    }
    context.fillText("x [mm]", width - 8, height - 6);
    context.textAlign = "left";
    context.fillText("y [mm]", 8, 16);
  }

  private handsReach(context: CanvasRenderingContext2D, tint: Colours): void {
    const { edge } = this.scene;
    if (!edge || !edge.length) return;
    trace(context, edge.map(([end]) => this.px(end)), true);
    context.fillStyle = tint.blue;
    context.globalAlpha = 0.1;
    context.fill();
    context.globalAlpha = 1;
    edge.forEach(([end, limit], i) => drawEdge(context, tint, this.px, [end, edge[(i + 1) % edge.length]![0]], limit));
  }

  private clamp(context: CanvasRenderingContext2D, tint: Colours): void {
    const [x, y] = this.px([0, 0]);
    context.fillStyle = tint.soft;
    context.strokeStyle = tint.muted;
    context.lineWidth = 1;
    context.beginPath();
    context.rect(x - 14, y - 17, 14, 34);
    context.fill();
    context.save();
    context.clip();
    for (let i = -20; i < 40; i += 6) {
      trace(context, [[x - 14, y + i], [x, y + i - 12]]);
      context.stroke();
    }
    context.restore();
    context.strokeStyle = tint.ink;
    context.lineWidth = 2;
    trace(context, [[x, y - 17], [x, y + 17]]);
    context.stroke();
  }

  private bent(context: CanvasRenderingContext2D, tint: Colours, opened: Opened, answer: Answer): void {
    const line = answer.line_m.map(this.px), at = this.px([answer.pose[0], answer.pose[1]]);
    for (const [wide, colour] of [[9, tint.paper], [5, tint.blue]] as const) {
      context.strokeStyle = colour;
      context.lineWidth = wide;
      trace(context, line);
      context.stroke();
    }
    const goal = this.scene.goal;
    if (goal && answer.limit) this.missed(context, tint, this.px(goal), at, answer);
    this.force(context, tint, opened, answer);
    if (opened.mode === "hand") this.hand(context, tint, at, answer.pose[2]);
    this.handle(context, tint, at);
    if (answer.ellipse && telling(answer.ellipse, opened)) {
      trace(context, answer.ellipse.outline_m.map(this.px), true);
      context.fillStyle = context.strokeStyle = tint.orange;
      context.globalAlpha = 0.22;
      context.fill();
      context.globalAlpha = 0.9;
      context.lineWidth = 1.2;
      context.stroke();
      context.globalAlpha = 1;
    }
  }

  private missed(context: CanvasRenderingContext2D, tint: Colours, goal: Point, at: Point, answer: Answer): void {
    context.strokeStyle = tint.orange;
    context.lineWidth = 1.4;
    context.setLineDash([3, 4]);
    trace(context, [at, goal]);
    context.stroke();
    context.setLineDash([]);
    context.beginPath();
    context.arc(goal[0], goal[1], 6, 0, 2 * Math.PI);
    context.stroke();
    trace(context, [[goal[0] - 10, goal[1]], [goal[0] + 10, goal[1]]]);
    context.stroke();
    trace(context, [[goal[0], goal[1] - 10], [goal[0], goal[1] + 10]]);
    context.stroke();
    if (answer.away_m < 5e-5) return;
    context.textAlign = "left";
    label(context, `${digits(1000 * answer.away_m)} mm out of reach`, goal[0] + 13, goal[1] - 7, tint.orange, tint.paper);
  }

  private force(context: CanvasRenderingContext2D, tint: Colours, opened: Opened, answer: Answer): void {
    const [fx, fy] = answer.force_N, size = Math.hypot(fx, fy);
    if (size < 1e-9) return;
    const from = this.px(answer.push_m), long = Math.max(42, 0.36 * this.scale * opened.length_m * Math.min(1, size / opened.max_force_N));
    const to: Point = [from[0] + long * fx / size, from[1] - long * fy / size];
    arrow(context, from, to, tint.paper, 6);
    arrow(context, from, to, tint.orange, 3);
    const below = to[1] > from[1];
    context.textAlign = to[0] >= from[0] ? "left" : "right";
    label(context, `${digits(size)} N`, to[0] + (to[0] >= from[0] ? 6 : -6), to[1] + (below ? 15 : -6), tint.ink, tint.paper);
    if (Math.abs(answer.moment_N_m) > 1e-9) this.moment(context, tint, answer);
  }

  private moment(context: CanvasRenderingContext2D, tint: Colours, answer: Answer): void {
    const [x, y] = this.px([answer.pose[0], answer.pose[1]]), turn = Math.sign(answer.moment_N_m), radius = 24;
    const begin = -answer.pose[2] + Math.PI - turn * 0.2, end = begin - turn * 2.2;
    context.strokeStyle = tint.orange;
    context.lineWidth = 2.2;
    context.beginPath();
    context.arc(x, y, radius, begin, end, turn > 0);
    context.stroke();
    const tip: Point = [x + radius * Math.cos(end), y + radius * Math.sin(end)], way = end - turn * Math.PI / 2;
    arrow(context, [tip[0] - 2 * Math.cos(way), tip[1] - 2 * Math.sin(way)], [tip[0] + 9 * Math.cos(way), tip[1] + 9 * Math.sin(way)], tint.orange, 2.2);
  }

  private hand(context: CanvasRenderingContext2D, tint: Colours, [x, y]: Point, angle: number): void {
    const knob = this.knob()!, [ux, uy] = [Math.cos(angle), -Math.sin(angle)];
    context.strokeStyle = tint.ink;
    context.lineWidth = 3;
    for (const side of [-1, 1]) {
      trace(context, [[x - 12 * ux - 9 * side * uy, y - 12 * uy + 9 * side * ux], [x + 10 * ux - 9 * side * uy, y + 10 * uy + 9 * side * ux]]);
      context.stroke();
    }
    trace(context, [[x + 10 * ux - 9 * uy, y + 10 * uy + 9 * ux], [x + 10 * ux + 9 * uy, y + 10 * uy - 9 * ux]]);
    context.stroke();
    context.lineWidth = 1.5;
    trace(context, [[x + 10 * ux, y + 10 * uy], knob]);
    context.stroke();
    context.beginPath();
    context.arc(knob[0], knob[1], 7, 0, 2 * Math.PI);
    context.fillStyle = tint.paper;
    context.fill();
    context.lineWidth = 2;
    context.stroke();
  }

  private handle(context: CanvasRenderingContext2D, tint: Colours, [x, y]: Point): void {
    for (const [wide, colour] of [[6, tint.paper], [2.5, tint.orange]] as const) {
      context.beginPath();
      context.arc(x, y, this.scene.held ? 12 : 10, 0, 2 * Math.PI);
      context.strokeStyle = colour;
      context.lineWidth = wide;
      context.stroke();
    }
    context.beginPath();
    context.arc(x, y, 2.5, 0, 2 * Math.PI);
    context.fillStyle = tint.orange;
    context.fill();
    if (!this.scene.focus) return;
    context.beginPath();
    context.arc(x, y, 16, 0, 2 * Math.PI);
    context.strokeStyle = tint.blue;
    context.lineWidth = 2;
    context.stroke();
  }
}
