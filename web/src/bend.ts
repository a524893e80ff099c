// The room Bend: drag a point of the learned beam, or a hand at its end.
import { commandLine, digits, fixed, h } from "./dom.js";
import { Canvas, Point } from "./draw.js";
import { ask, listen, Message, onReturn, say, send, whoAmI } from "./net.js";
import { atEnd, remember } from "./place.js";
import { Answer, Ellipse, Opened, Plane, ReachMap, Scene, telling } from "./plane.js";

interface Found { name: string; kind: "recording" | "result"; grade?: string; known?: string; changed: number }
type Grab = "point" | "turn" | null;

const NEAR = 26;  // px: a finger is as wide
const GRADES: Record<string, string> = { "not to be trusted": "bad" };

export function bend(place: HTMLElement, at: URLSearchParams): void {
  const scene: Scene = { opened: null, answer: null, map: null, edge: null, goal: null, held: false, focus: false };
  const plane = new Plane(scene), element = h("canvas", {
    tabindex: 0, role: "application", "aria-describedby": "bend-readout",
    "aria-label": "The beam in its plane. Arrow keys move the point, with Shift further, with Alt less; Q and E turn the hand; Escape lets go.",
  });
  const canvas = new Canvas(element, plane.paint), command = commandLine(), panel = new Panel(change);
  const choice = h("select", { "aria-label": "learned beam", change: () => open(choice.value) });
  let model = at.get("model") ?? "", grab: Grab = null, number = 0, wanted: number[] | null = null, waiting = 0;
  const asked = new Map<number, number>();  // when each drag began

  place.append(
    h("section", { class: "stage" }, h("div", { class: "toolbar" }, choice, panel.modes, panel.status), element, command.element),
    panel.element,
  );
  command.set("");

  function open(name: string): void {
    model = name;
    Object.assign(scene, { opened: null, answer: null, map: null, edge: null, goal: null });
    remember({ model });
    send({ do: "open", model });
    canvas.redraw();
  }

  function change(settings: Record<string, unknown>): void {
    scene.goal = null;
    send({ do: "set", model, settings });
  }

  function move(goal: Point, angle?: number): void {
    scene.goal = goal;
    wanted = angle === undefined ? goal : [...goal, angle];
    if (!waiting) waiting = requestAnimationFrame(flush);
    canvas.redraw();
  }

  function flush(): void {
    waiting = 0;
    if (!wanted || asked.size > 2) return;  // the next answer sends what is wanted then
    number += 1;
    asked.set(number, performance.now());
    if (!send({ do: "drag", model, n: number, goal: wanted })) asked.clear();
    wanted = null;
  }

  function hear(message: Message): void {
    if (message.what === "places") void fill(false);
    if (message.what === "error") say(message.text as string);
    if (message.model !== model) return;
    if (message.what === "beam") {
      const opened = message.opened as Opened;
      if (opened.version !== scene.opened?.version) scene.map = null;
      scene.opened = opened;
      take(message.answer as Answer);
      panel.opened(opened);
    } else if (message.what === "answer") {
      const mine = message.by === whoAmI(), began = asked.get(message.n as number);
      if (mine) for (const n of [...asked.keys()]) if (n <= (message.n as number)) asked.delete(n);
      if (!mine) scene.goal = (message.answer as Answer).goal_m;
      take(message.answer as Answer);
      if (mine && began !== undefined) requestAnimationFrame(() => performance.measure("drag", { start: began, end: performance.now() }));
      if (wanted && !waiting) waiting = requestAnimationFrame(flush);
    } else if (message.what === "map") {
      scene.map = message.map as ReachMap;
      panel.mapped();
    } else if (message.what === "edge") {
      scene.edge = message.edge as Scene["edge"];
    } else if (message.what === "ellipse" && scene.answer) {
      scene.answer.ellipse = message.ellipse as Ellipse;
      panel.answer(scene.opened!, scene.answer);
    }
    canvas.redraw();
  }

  function take(answer: Answer): void {
    scene.answer = answer;
    command.set(answer.command);
    if (scene.opened) panel.answer(scene.opened, answer);
  }

  async function fill(first: boolean): Promise<void> {
    const { found } = await ask<{ found: Found[] }>("/api/places");
    const results = found.filter((one) => one.kind === "result");
    choice.replaceChildren(...results.map((one) => h("option", { value: one.name, selected: one.name === model }, one.name)));
    choice.hidden = !results.length;
    if (!results.some((one) => one.name === model)) model = results.sort((a, b) => b.changed - a.changed)[0]?.name ?? "";
    if (!model) {
      panel.empty();
      return;
    }
    choice.value = model;
    const grade = results.find((one) => one.name === model)?.grade ?? "";
    choice.className = GRADES[grade] ?? "";
    if (first || !scene.opened) open(model);
  }

  // The pointer: on the knob it turns the hand; near the beam it takes another point; elsewhere the point goes there.
  function where(event: PointerEvent): Point {
    const box = element.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  function apart(a: Point, b: Point): number {
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  }

  element.addEventListener("pointerdown", (event) => {
    const { opened, answer } = scene;
    if (!opened || !answer || event.button !== 0) return;
    element.setPointerCapture(event.pointerId);
    const pointer = where(event), knob = plane.knob();
    const handle = plane.px([answer.pose[0], answer.pose[1]]);
    grab = knob && apart(pointer, knob) < NEAR ? "turn" : "point";
    scene.held = true;
    if (opened.mode === "point" && apart(pointer, handle) > NEAR) {
      const away = answer.line_m.map((one) => apart(plane.px(one), pointer)), near = Math.min(...away);
      const s = Math.max(0.1, Math.round(100 * away.indexOf(near) / (away.length - 1)) / 100);
      if (near < 14 && Math.abs(s - opened.point_s) > 0.03) change({ point_s: s, push_s: panel.linked ? s : opened.push_s });
    }
    drag(event);
    event.preventDefault();
    element.focus({ preventScroll: true });
  });
  element.addEventListener("pointermove", drag);
  for (const name of ["pointerup", "pointercancel"] as const) {
    element.addEventListener(name, () => {
      grab = null;
      scene.held = false;
      canvas.redraw();
    });
  }

  function drag(event: PointerEvent): void {
    if (!grab || !scene.answer) return;
    const pointer = where(event), [x, y] = scene.answer.pose;
    if (grab === "point") {
      move(plane.metres(pointer));
      return;
    }
    const end = plane.px([x, y]);
    move(scene.goal ?? [x, y], near(Math.atan2(end[1] - pointer[1], pointer[0] - end[0]), scene.answer.pose[2]));
  }

  element.addEventListener("keydown", (event) => {
    const { opened, answer } = scene;
    if (!opened || !answer || event.ctrlKey || event.metaKey) return;
    const step = opened.length_m * (event.shiftKey ? 0.05 : event.altKey ? 0.001 : 0.01);
    const ways: Record<string, Point> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const way = ways[event.key], [x, y, angle] = answer.pose;
    const from: Point = answer.limit ? [x, y] : scene.goal ?? [x, y];
    if (way) move([from[0] + step * way[0], from[1] + step * way[1]]);
    else if (/^[qe]$/i.test(event.key) && opened.mode === "hand") move(from, angle + (event.key.toLowerCase() === "q" ? 1 : -1) * (event.shiftKey ? 0.1 : 0.02));
    else if (event.key === "Escape") change({ rest: true });
    else if (event.key.toLowerCase() === "h") change({ mode: opened.mode === "hand" ? "point" : "hand" });
    else return;
    event.preventDefault();
  });
  element.addEventListener("focus", () => { scene.focus = element.matches(":focus-visible"); canvas.redraw(); });
  element.addEventListener("blur", () => { scene.focus = false; canvas.redraw(); });

  atEnd(listen(hear), onReturn(() => { asked.clear(); void fill(true); }), () => canvas.end());
}

// The angle nearest to another: a hand may be turned round and round.
function near(angle: number, other: number): number {
  return angle + 2 * Math.PI * Math.round((other - angle) / (2 * Math.PI));
}

// Numbers and settings beside the plane.
class Panel {
  readonly modes: HTMLElement;
  readonly status = h("p", { class: "status", role: "status" });
  readonly element: HTMLElement;
  private readonly rows: Record<string, HTMLElement> = {};
  private readonly bar = h("i");
  private readonly point = h("input", { type: "range", min: 0.1, max: 1, step: 0.01, "aria-label": "point s" });
  private readonly push = h("input", { type: "range", min: 0.1, max: 1, step: 0.01, "aria-label": "force at s" });
  private readonly link = h("input", { type: "checkbox", checked: true });
  private readonly largest = h("input", { type: "number", min: 0.001, step: "any", "aria-label": "largest force in N" });
  private readonly texts = { point: h("output"), push: h("output") };
  private readonly buttons: Record<string, HTMLButtonElement> = {};
  private readonly doubts = h("p", { class: "warning", hidden: true });

  constructor(change: (settings: Record<string, unknown>) => void) {
    const mode = (name: string, words: string, says: string): HTMLButtonElement => {
      const button = h("button", { type: "button", title: says, click: () => change({ mode: name }) }, words);
      this.buttons[name] = button;
      return button;
    };
    this.modes = h("div", { class: "switch", role: "group", "aria-label": "held by" },
      mode("point", "force at a point", "A force holds the point; it turns as it likes"),
      mode("hand", "hand at the end", "A hand holds the end at a place and an angle (H)"));
    this.point.addEventListener("change", () => change({ point_s: this.point.valueAsNumber, ...(this.linked ? { push_s: this.point.valueAsNumber } : {}) }));
    this.push.addEventListener("change", () => change({ push_s: this.push.valueAsNumber }));
    for (const [slider, text] of [[this.point, this.texts.point], [this.push, this.texts.push]] as const) {
      slider.addEventListener("input", () => {
        text.textContent = slider.valueAsNumber.toFixed(2);
        if (slider === this.point && this.linked) [this.push.value, this.texts.push.textContent] = [this.point.value, text.textContent];
      });
    }
    this.link.addEventListener("change", () => { if (this.linked) change({ push_s: this.point.valueAsNumber }); else this.push.disabled = false; });
    this.largest.addEventListener("change", () => { if (this.largest.valueAsNumber > 0) change({ max_force_N: this.largest.valueAsNumber }); });
    this.element = h("aside", { class: "panel" }, this.numbers(), this.settings(), h("p", { class: "quiet keys" },
      h("kbd", {}, "←↑→↓"), " move, ", h("kbd", {}, "Shift"), " further, ", h("kbd", {}, "Alt"), " less · ", h("kbd", {}, "Q"), " ", h("kbd", {}, "E"),
      " turn the hand · ", h("kbd", {}, "H"), " hand or force · ", h("kbd", {}, "Esc"), " rest"));
  }

  get linked(): boolean {
    return this.link.checked;
  }

  private row(key: string, words: string, unit: string): HTMLElement {
    const value = h("b");
    this.rows[key] = value;
    return h("div", { class: "row" }, h("dt", {}, words), h("dd", {}, value, " ", h("span", { class: "unit" }, unit)));
  }

  private numbers(): HTMLElement {
    const big = h("p", { class: "big" });
    this.rows.big = big;
    return h("section", {}, h("h2", {}, "Force on the beam"), big,
      h("dl", { id: "bend-readout" },
        this.row("components", "components", "N"), this.row("moment", "moment", "N mm"),
        this.row("place", "point", "mm"), this.row("angle", "tangent's angle", "°"),
        this.row("ellipse", "95 % ellipse", "mm"), this.row("bend", "largest curvature", "1/m"),
        this.row("margin", "stability", "")),
      h("div", { class: "margin", title: "1: no load; 0: the beam buckles or falls" }, this.bar), this.doubts);
  }

  private settings(): HTMLElement {
    return h("section", { class: "settings" }, h("h2", {}, "How it is held"),
      h("label", {}, h("span", {}, "point s"), this.point, this.texts.point),
      h("label", {}, h("span", {}, "force at s"), this.push, this.texts.push),
      h("label", { class: "check" }, this.link, "the force acts at the point"),
      h("label", {}, h("span", {}, "largest force"), this.largest, h("span", { class: "unit" }, "N")),
      h("p", { class: "legend" }, h("span", {}, h("i", { class: "area" }), "reachable"),
        h("span", {}, h("i", { class: "edge" }), "edge of stability"), h("span", {}, h("i", { class: "ellipse" }), "95 % ellipse")));
  }

  opened(opened: Opened): void {
    const hand = opened.mode === "hand";
    this.point.value = String(opened.point_s);
    this.push.value = String(opened.push_s);
    this.texts.point.textContent = opened.point_s.toFixed(2);
    this.texts.push.textContent = opened.push_s.toFixed(2);
    if (opened.push_s !== opened.point_s) this.link.checked = false;
    this.point.disabled = this.link.disabled = hand;
    this.push.disabled = hand || this.linked;
    if (document.activeElement !== this.largest) this.largest.value = String(opened.max_force_N);
    for (const [name, button] of Object.entries(this.buttons)) button.setAttribute("aria-pressed", String(name === opened.mode));
    this.rows.moment!.closest<HTMLElement>(".row")!.hidden = !hand;
    this.rows.ellipse!.closest<HTMLElement>(".row")!.hidden = hand || !opened.band;
    this.doubts.hidden = !opened.doubts.length;
    this.doubts.textContent = opened.doubts.length ? `k(s) is not to be trusted: ${opened.doubts.join("; ")}` : "";
    this.element.classList.toggle("mapping", !hand);
  }

  mapped(): void {
    this.element.classList.remove("mapping");
  }

  answer(opened: Opened, answer: Answer): void {
    const [fx, fy] = answer.force_N, size = Math.hypot(fx, fy), [x, y, angle] = answer.pose, mm = (value: number): string => fixed(1000 * value, 2);
    this.rows.big!.replaceChildren(h("b", {}, digits(size)), " N", h("span", {}, ` at ${fixed(180 * Math.atan2(fy, fx) / Math.PI, 1)}°`));
    this.rows.components!.textContent = `${fixed(fx, 4)}, ${fixed(fy, 4)}`;
    this.rows.moment!.textContent = fixed(1000 * answer.moment_N_m, 2);
    this.rows.place!.textContent = `${mm(x)}, ${mm(y)}`;
    this.rows.angle!.textContent = fixed(180 * angle / Math.PI, 1);
    const known = answer.ellipse && telling(answer.ellipse, opened);
    this.rows.ellipse!.textContent = known ? answer.ellipse!.semi_axes_m.map((one) => fixed(1000 * one, 2)).join(", ") : "not bounded here";
    this.rows.bend!.textContent = digits(answer.bend_per_m);
    this.rows.margin!.textContent = fixed(answer.margin, 3);
    this.bar.style.width = `${100 * Math.min(Math.max(answer.margin, 0), 1)}%`;
    this.bar.className = answer.margin < 0.1 ? "low" : "";
    this.status.textContent = why(opened, answer);
    this.status.className = answer.limit ? "status warning" : "status";
  }

  empty(): void {
    this.status.replaceChildren("No learned beam in this folder yet. ", h("a", { href: "#learn" }, "Learn a recording"), " first.");
  }
}

function why(opened: Opened, { limit, away_m, turned_away_rad }: Answer): string {
  if (!limit) return "on its goal";
  const away = away_m < 1e-5 ? `${fixed(Math.abs(180 * turned_away_rad / Math.PI), 1)}° from the angle` : `${digits(1000 * away_m)} mm from the goal`;
  const who = opened.mode === "hand" ? "hand" : "force";
  return limit === "stability" ? `edge of stability, ${away}` : `no ${who} of up to ${digits(opened.max_force_N)} N holds it there, ${away}`;
}
