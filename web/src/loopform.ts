// What is simulated: the goal, how late and how wrong things are.
import { digits, h } from "./dom.js";
import { Point } from "./draw.js";
import { Beam } from "./looped.js";

export interface Values {
  goal_m: Point; push_s: number; point_s: number; k_error: number; draws: number; delay_ms: number; fps: number; noise_mm: number; duration_s: number;
  max_force_N: number | null;
}
export interface Settings extends Values { model: string }
type Kept = Record<string, string>;

const USUAL = { x: 0, y: 0, push: 1, point: 1, wrong: 30, draws: 3, delay: 50, fps: 30, noise: 0.05, last: 8 };
const BOUNDS: Record<string, [number, number]> = { x: [-1e6, 1e6], y: [-1e6, 1e6], push: [0.05, 1], point: [0.05, 1], wrong: [0, 95], draws: [1, 8], delay: [0, 10_000],
  fps: [0.1, 1000], noise: [0, 1000], last: [2, 600] };

const MOST_N: [number, number] = [1e-6, 1e6];
const range = ([least, most]: [number, number]): string => `a number from ${least} to ${most}`;

export class SettingsForm {
  readonly element: HTMLElement;
  given: boolean;  // whether the address says what is simulated
  private readonly fields: Record<string, HTMLInputElement> = {};
  private readonly notes = new Map<HTMLInputElement, HTMLElement>();
  private length_m = Infinity;  // of the beam
  private readonly drawn: HTMLInputElement;
  private readonly wrongly: HTMLInputElement;
  private readonly most = h("input", { type: "number", min: MOST_N[0], max: MOST_N[1], step: "any", placeholder: "none", "aria-label": "largest force in N", input: () => this.changed() });
  private readonly band: HTMLElement;

  constructor(at: URLSearchParams, private readonly changed: () => void) {
    this.given = at.has("x");
    const field = (key: keyof typeof USUAL, says: string, step: number | "any"): HTMLInputElement => {
      const [min, max] = BOUNDS[key]!;
      return this.fields[key] = h("input", { type: "number", min, max, step, value: at.get(key) ?? USUAL[key], "aria-label": says, input: () => this.changed() });
    };
    const note = (input: HTMLInputElement): HTMLElement => {
      const words = h("p", { class: "wrong", role: "alert", hidden: true });
      this.notes.set(input, words);
      return words;
    };
    const row = (words: string, input: HTMLInputElement, unit: string): HTMLElement =>
      h("div", {}, h("label", {}, h("span", {}, words), input, h("span", { class: "unit" }, unit)), note(input));
    this.wrongly = h("input", { type: "radio", name: "beams", checked: at.get("beams") !== "drawn", change: () => this.changed() });
    this.drawn = h("input", { type: "radio", name: "beams", checked: at.get("beams") === "drawn", change: () => this.changed() });
    this.band = h("label", { class: "either" }, this.drawn, h("span", {}, "drawn from its band"), field("draws", "beams that are drawn", 1), h("span", { class: "unit" }, "beams"));
    const wrong = field("wrong", "k is wrong by, in percent", "any"), draws = this.fields.draws!;
    if (at.has("most")) this.most.value = at.get("most")!;
    this.element = h("section", { class: "settings" }, h("h2", {}, "Goal"), row("x", field("x", "goal, x in mm", "any"), "mm"), row("y", field("y", "goal, y in mm", "any"), "mm"),
      row("point s", field("point", "point that is led, s", 0.01), ""), row("force at s", field("push", "place of the force, s", 0.01), ""),
      h("h2", {}, "The true k(s) is"), h("label", { class: "either" }, this.wrongly, h("span", {}, "lower and higher by"), wrong, h("span", { class: "unit" }, "%")), note(wrong), this.band, note(draws),
      h("h2", {}, "The camera"), row("comes late by", field("delay", "delay in ms", "any"), "ms"), row("frames", field("fps", "frames a second", "any"), "1/s"), row("noise", field("noise", "noise in mm, one standard deviation", "any"), "mm"),
      h("h2", {}, "The robot"), row("largest force", this.most, "N"), row("it lasts", field("last", "duration in s", "any"), "s"));
  }

  private number(key: string): number {
    return this.fields[key]!.valueAsNumber;
  }

  // Marks the fields that cannot be run as they stand; the name of the first, or nothing.
  wrong(): string {
    const found = new Map<HTMLInputElement, string>(), isDrawn = this.drawn.checked && !this.drawn.disabled;
    const within = (value: number, [least, most]: [number, number]): boolean => value >= least && value <= most;
    for (const [key, field] of Object.entries(this.fields)) {
      const used = key === "draws" ? isDrawn : key === "wrong" ? !isDrawn : true, value = field.valueAsNumber;
      if (used && !(within(value, BOUNDS[key]!) && (key !== "draws" || Number.isInteger(value)))) found.set(field, range(BOUNDS[key]!));
    }
    if ((this.most.value !== "" || this.most.validity.badInput) && !within(this.most.valueAsNumber, MOST_N)) found.set(this.most, `${range(MOST_N)}, or empty: no limit`);
    const reach = this.length_m * this.number("point"), away = Math.hypot(this.number("x"), this.number("y")) / 1000;
    if (!found.size && away > reach) found.set(this.fields.x!, `The goal is ${digits(1000 * away)} mm from the clamp: out of the beam's reach (${digits(1000 * reach)} mm).`);
    for (const [field, note] of this.notes) {
      const words = found.get(field) ?? "";
      field.setAttribute("aria-invalid", String(words !== ""));
      [field.title, note.textContent, note.hidden] = [words, words, !words];
    }
    const [first] = found.keys();
    return first?.getAttribute("aria-label") ?? "";
  }

  // Where the goal is drawn; nothing while its fields hold no numbers.
  get goal(): Point | null {
    const goal: Point = [this.number("x") / 1000, this.number("y") / 1000];
    return goal.every(Number.isFinite) ? goal : null;
  }

  get values(): Values {
    const most = this.most.valueAsNumber, metres = (key: string): number => Number((this.number(key) / 1000).toFixed(6));
    return { goal_m: [metres("x"), metres("y")], push_s: this.number("push"), point_s: this.number("point"), k_error: this.number("wrong") / 100,
      draws: this.drawn.checked && !this.drawn.disabled ? this.number("draws") : 0, delay_ms: this.number("delay"), fps: this.number("fps"),
      noise_mm: this.number("noise"), duration_s: this.number("last"), max_force_N: Number.isFinite(most) ? most : null };
  }

  set goal([x, y]: Point) {
    this.fields.x!.value = String(Number((1000 * x).toFixed(2)));
    this.fields.y!.value = String(Number((1000 * y).toFixed(2)));
    this.changed();
  }

  // A beam; without a goal one that it reaches.
  of(beam: Beam, goal: Point | null): void {
    this.length_m = beam.length_m;
    this.drawn.disabled = !beam.band;
    this.band.title = beam.band ? "" : "This result has no band.";
    if (!beam.band) this.wrongly.checked = true;
    if (!goal) this.goal = beam.goal_m;
  }

  // As they were when this was simulated.
  adopt(values: Values): void {
    this.given = true;
    const put: Record<string, number> = { x: 1000 * values.goal_m[0], y: 1000 * values.goal_m[1], push: values.push_s, point: values.point_s, wrong: 100 * values.k_error,
      delay: values.delay_ms, fps: values.fps, noise: values.noise_mm, last: values.duration_s, ...(values.draws ? { draws: values.draws } : {}) };
    for (const [key, value] of Object.entries(put)) this.fields[key]!.value = String(Number(value.toFixed(4)));
    (values.draws ? this.drawn : this.wrongly).checked = true;
    this.most.value = values.max_force_N === null ? "" : String(values.max_force_N);
  }

  // For the address.
  kept(model: string): Kept {
    const own = Object.fromEntries(Object.entries(this.fields).map(([key, field]) => [key, Number(field.value) === USUAL[key as keyof typeof USUAL] ? "" : field.value]));
    return { model, ...own, x: this.fields.x!.value, y: this.fields.y!.value, beams: this.drawn.checked ? "drawn" : "", most: this.most.value };
  }
}
