// The room Bend: drag a point of the learned beam, or a hand at its end.
import { coded, commandLine, h } from "./dom.js";
import { Canvas, Point } from "./draw.js";
import { ask, listen, Message, onReturn, say, send, whoAmI } from "./net.js";
import { atEnd, remember } from "./place.js";
import { Panel } from "./panel.js";
import { Answer, Ellipse, Opened, Plane, Scene } from "./plane.js";
import { ReachMap } from "./reach.js";

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
  const broken = h("p", { class: "warning", role: "alert", hidden: true });
  let model = at.get("model") ?? "", grab: Grab = null, number = 0, wanted: number[] | null = null, waiting = 0;
  const asked = new Map<number, number>();  // when each drag began

  place.append(
    h("section", { class: "stage" }, h("div", { class: "toolbar" }, choice, panel.modes, panel.status), broken, element, command.element),
    panel.element,
  );
  command.set("");

  function open(name: string): void {
    model = name;
    broken.hidden = true;
    command.set("");
    panel.clear();
    Object.assign(scene, { opened: null, answer: null, map: null, edge: null, goal: null });
    remember("bend", { model });
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
    for (const [n, began] of asked) if (performance.now() - began > 1000) asked.delete(n);  // nobody answers it any more
    if (!wanted || asked.size > 2) return;  // the next answer sends what is wanted then
    number += 1;
    asked.set(number, performance.now());
    if (!send({ do: "drag", model, n: number, goal: wanted })) asked.clear();
    wanted = null;
  }

  function hear(message: Message): void {
    if (message.what === "places") void fill(false);
    if (message.what === "error") {
      if (scene.opened) say(message.text as string);
      broken.hidden = scene.opened !== null;  // of a beam that cannot be opened it stays
      broken.replaceChildren(...coded(message.text as string));
    }
    if (message.model !== model) return;
    if (message.what === "forgotten" && !document.hidden) open(model);
    if (message.what === "beam") {
      const opened = message.opened as Opened;
      if (opened.version !== scene.opened?.version) scene.map = null;
      scene.opened = opened;
      broken.hidden = true;
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

  const back = (): void => { if (!document.hidden) send({ do: "open", model }); };
  document.addEventListener("visibilitychange", back);
  atEnd(() => document.removeEventListener("visibilitychange", back), listen(hear), onReturn(() => { asked.clear(); void fill(true); }), () => canvas.end());
}

// The angle nearest to another: a hand may be turned round and round.
function near(angle: number, other: number): number {
  return angle + 2 * Math.PI * Math.round((other - angle) / (2 * Math.PI));
}
