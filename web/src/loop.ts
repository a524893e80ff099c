// The room Loop: the closed loop with a late camera, on beams that are not the model.
import { coded, commandLine, digits, fixed, h } from "./dom.js";
import { Canvas, Point } from "./draw.js";
import { Settings, SettingsForm } from "./loopform.js";
import { Beam, LoopPlane, LoopScene, tintOfTrial, Trial } from "./looped.js";
import { ask, listen, Message, onReturn, post, say } from "./net.js";
import { atEnd, remember } from "./place.js";
import { ReachMap } from "./reach.js";
import { TimeChart } from "./timechart.js";
import { isBusy, Job, progressOf } from "./work.js";

interface Found { name: string; kind: string; changed: number }
interface Control { force_N: Point; rise_s: number; gain: number | null; phase_rad: number | null; delay_s: number | null; softest: number | null; rate_per_s: number }
type Outcome = Partial<{ control: Control; trial: Trial }>;
type LoopJob = Job & Settings;

export function loop(place: HTMLElement, at: URLSearchParams): void {
  const scene: LoopScene = { beam: null, map: null, goal: [0, 0], trials: [], now: 0, push: 1, point: 1, stale: false, focus: false };
  const plane = new LoopPlane(scene), element = h("canvas", { tabindex: 0, role: "application",
    "aria-label": "The beam and its goal. Arrow keys move the goal, with Shift further, with Alt less; the space bar plays." });
  const canvas = new Canvas(element, plane.paint), command = commandLine(), form = new SettingsForm(at, changed);
  const choice = h("select", { "aria-label": "learned beam", change: () => { void open(choice.value, null); } });
  const start = h("button", { type: "button", class: "main", click: () => { void begin(); } }, "Simulate"), progress = h("div");
  const play = h("button", { type: "button", "aria-label": "play", click: () => run(!timer) }, "▶");
  const slider = h("input", { type: "range", min: 0, max: 8, step: 0.01, value: 0, "aria-label": "time" }), clock = h("output", { class: "clock" });
  const error = new TimeChart("from the goal [mm]", true, seek), force = new TimeChart("force on the beam [N]", false, seek);
  const results = h("div", { class: "scroll" }), margins = h("dl", {}), status = h("p", { class: "status", role: "status" });
  const broken = h("p", { class: "warning", role: "alert", hidden: true });
  let good: { job: LoopJob; found: Outcome[] } | null = null, shown: LoopJob | null = null;  // the last that came to something, and what is seen
  let model = at.get("model") ?? "", job: LoopJob | null = null, control: Control | null = null, timer = 0, last = 0, got = "", mapped = "", soon = 0;

  place.append(h("section", { class: "stage" }, h("div", { class: "toolbar" }, choice, start, status), broken, progress, element,
    h("div", { class: "under scrub" }, play, slider, clock), h("div", { class: "charts" }, error.element, force.element),
    h("section", { class: "outcome" }, results, margins), command.element),
  h("aside", { class: "panel" }, form.element,
    h("p", { class: "quiet keys" }, "drag the goal, or ", h("kbd", {}, "←↑→↓"), " move it, ", h("kbd", {}, "Shift"), " further, ", h("kbd", {}, "Alt"), " less · ", h("kbd", {}, "space"), " play")));
  command.set("");

  function wanted(): Settings {
    return { model, ...form.values };
  }

  function changed(): void {
    const settings = wanted(), wrong = form.wrong();
    scene.goal = form.goal ?? scene.goal;
    scene.stale = scene.trials.length > 0 && !same(settings, shown);
    start.textContent = wrong ? `Not to be run: ${wrong}` : "Simulate";
    start.disabled = !scene.beam || wrong !== "" || isBusy(job);
    canvas.redraw();
    tell();
    clearTimeout(soon);
    if (wrong) {
      command.set("");
      return;
    }
    remember("loop", form.kept(model));
    command.set(model ? lineOf(settings) : "");
    soon = window.setTimeout(() => { void reach(); }, 250);
  }

  // What a force can hold at all, so that a goal may be chosen from it.
  async function reach(): Promise<void> {
    if (!scene.beam || scene.beam.name !== model) return;
    const { push_s, point_s, max_force_N } = form.values, asked = { model, push_s, point_s, max_force_N }, key = JSON.stringify(asked);
    if (key === mapped) return;
    mapped = key;
    scene.map = null;
    const found = await post<ReachMap>("/api/reach", asked);
    if (key === mapped) scene.map = found;
    canvas.redraw();
  }

  function same(settings: Settings, other: Settings | null): boolean {
    return other !== null && JSON.stringify(Object.keys(settings).map((key) => settings[key as keyof Settings])) ===
      JSON.stringify(Object.keys(settings).map((key) => other[key as keyof Settings]));
  }

  function tell(): void {
    if (!scene.beam) return;
    status.textContent = scene.stale ? "Other settings than those that were simulated: simulate again." : scene.beam.doubts.length ? "k(s) of this beam is not to be trusted." :
      !scene.beam.mass ? "No mass was learned: it is taken as 10 g/m." : "";
    status.classList.toggle("warning", scene.beam.doubts.length > 0);
  }

  async function begin(): Promise<void> {
    say("");
    await post("/api/work/loop/start", wanted());
  }

  // Another beam, with a goal of its own where none is given.
  async function open(name: string, goal: Point | null): Promise<void> {
    model = name;
    let beam: Beam | null = null, words = "";
    try {
      beam = await ask<Beam>("/api/beam", { name });
    } catch (error) {
      words = (error as Error).message;
    }
    if (model !== name) return;
    broken.hidden = !words;
    broken.replaceChildren(...coded(words));
    [scene.beam, scene.map, mapped] = [beam, null, ""];
    choice.value = name;
    if (beam) form.of(beam, goal);
    if (job?.model !== name) take(job, []);
    changed();
  }

  async function fill(): Promise<void> {
    const { found } = await ask<{ found: Found[] }>("/api/places");
    const beams = found.filter((one) => one.kind === "result");
    choice.replaceChildren(...beams.map((one) => h("option", { value: one.name, selected: one.name === model }, one.name)));
    choice.hidden = start.hidden = !beams.length;
    const state = await ask<{ job: LoopJob | null; found: Outcome[] }>("/api/work/loop");
    if (!beams.some((one) => one.name === model)) model = state.job && beams.some((one) => one.name === state.job!.model) ? state.job.model : beams.sort((a, b) => b.changed - a.changed)[0]?.name ?? "";
    if (!model) {
      status.replaceChildren("No learned beam in this folder yet. ", h("a", { href: "#learn" }, "Learn a recording"), " first.");
      return;
    }
    const first = !scene.beam;
    if (first && state.job && state.job.model === model && !form.given) form.adopt(state.job);
    if (scene.beam?.name !== model) await open(model, form.given ? form.values.goal_m : null);
    take(state.job, state.found);
  }

  // The work as it stands; other settings than those on the page come from another tab, or from this one before.
  function take(now: LoopJob | null, found: Outcome[]): void {
    job = now;
    const busy = isBusy(now), mine = now !== null && now.model === model;
    progress.replaceChildren(...(now && (busy || now.state === "failed" && mine) ? [progressOf(now, `Simulating ${now.model}`, "loop")] : []));
    shown = mine ? now : null;
    if (mine && found.some((one) => one.trial)) good = { job: now, found };
    else if (mine && !busy && good?.job.model === model) [shown, found] = [good.job, good.found];  // it came to nothing: what is seen stays
    control = shown ? found.find((one) => one.control)?.control ?? null : null;
    scene.trials = shown ? found.flatMap((one) => one.trial ? [one.trial] : []) : [];
    if (shown) [scene.push, scene.point] = [shown.push_s, shown.point_s];
    const fresh = shown ? `${shown.began}` : "";
    if (fresh !== got) {
      got = fresh;
      seek(0);
    }
    const until = shown ? shown.duration_s : 8;
    slider.max = String(until);
    slider.disabled = play.disabled = !scene.trials.some((one) => one.time_s);
    const lines = scene.trials.filter((one) => one.time_s).map((one) => ({ one, tint: tintOfTrial(one), thin: one.drawn }));
    error.set(lines.map(({ one, ...look }) => ({ ...look, time: one.time_s!, values: one.error_m!.map((value) => 1000 * value) })), [{ value: 1, words: "1 mm: settled" }], until);
    force.set(lines.map(({ one, ...look }) => ({ ...look, time: one.time_s!, values: one.force_N!.map(([x, y]) => Math.hypot(x, y)) })),
      control ? [{ value: Math.hypot(...control.force_N), words: "force of the model for the goal" }] : [], until);
    table();
    changed();
  }

  function table(): void {
    results.replaceChildren(...(scene.trials.length ? [h("table", {}, h("tr", {}, h("th", {}, "true k(s)"), h("th", { title: "the largest distance from the goal in the last second" }, "last second"), h("th", { title: "from when on it stays within 1 mm" }, "settled")),
      ...scene.trials.map((one) => h("tr", {}, h("td", {}, h("i", { class: `dot ${tintOfTrial(one)}` }), one.name),
        h("td", { class: "number" }, one.time_s ? `${fixed(1000 * one.steady_m!, 2)} mm` : "snapped away"),
        h("td", { class: "number" }, one.settled_s === null ? "never" : `at ${fixed(one.settled_s, 1)} s`))))] : [h("p", { class: "quiet" }, "Nothing was simulated with this beam yet.")]));
    const rows: [string, string][] = control ? [["force of the model", `${digits(Math.hypot(...control.force_N))} N in ${fixed(control.rise_s, 2)} s`],
      ["gain margin", control.gain === null ? "any" : `${fixed(control.gain, 2)} times`], ["phase margin", control.phase_rad === null ? "any" : `${fixed(180 * control.phase_rad / Math.PI, 0)}°`],
      ["further delay", control.delay_s === null ? "no limit found" : `${fixed(1000 * control.delay_s, 0)} ms`],
      ["stable while", control.softest === null ? "k(s) has any size" : `k(s) is above ${fixed(control.softest, 2)} times the model's`]] : [];
    margins.replaceChildren(...rows.map(([what, words]) => h("div", { class: "row" }, h("dt", {}, what), h("dd", {}, words))));
  }

  function seek(time: number): void {
    scene.now = time;
    slider.value = String(time);
    clock.textContent = `${time.toFixed(2)} s`;
    error.at(time);
    force.at(time);
    canvas.redraw();
  }

  function run(on: boolean): void {
    cancelAnimationFrame(timer);
    timer = 0;
    play.textContent = on ? "❚❚" : "▶";
    play.setAttribute("aria-label", on ? "stop playing" : "play");
    if (!on) return;
    if (scene.now >= Number(slider.max) - 0.02) seek(0);
    last = performance.now();
    timer = requestAnimationFrame(step);
  }

  function step(now: number): void {
    const time = Math.min(scene.now + (now - last) / 1000, Number(slider.max));
    last = now;
    seek(time);
    if (time >= Number(slider.max)) run(false);
    else timer = requestAnimationFrame(step);
  }

  slider.addEventListener("input", () => { run(false); seek(slider.valueAsNumber); });

  async function hear(message: Message): Promise<void> {
    if (message.what === "places") await fill();
    if (message.what !== "work" || message.room !== "loop") return;
    const now = message.job as LoopJob, begun = now.began !== job?.began;
    if (begun) {  // here or in another tab: all show it
      if (now.model !== model || !same(wanted(), now)) {
        form.adopt(now);
        await open(now.model, now.goal_m);
      }
      take(now, []);
      return;
    }
    const found = now.found === job?.found && now.state === job.state ? null : (await ask<{ found: [] }>("/api/work/loop")).found;
    const before = scene.trials.length;
    if (found) take(now, found);
    else progress.replaceChildren(progressOf(now, `Simulating ${now.model}`, "loop"));
    if (before === 0 && scene.trials.some((one) => one.time_s) && !matchMedia("(prefers-reduced-motion: reduce)").matches) run(true);
  }

  function lineOf(settings: Settings): string {
    const number = (value: number): string => String(Number(value.toFixed(6))), quoted = /^[\w@%+=:,./-]+$/.test(settings.model) ? settings.model : `'${settings.model.replaceAll("'", "'\\''")}'`;
    const words = ["onebend", "loop", quoted, "--goal", ...settings.goal_m.map(number)];
    if (settings.push_s !== 1) words.push("--push-at", number(settings.push_s));
    if (settings.point_s !== 1) words.push("--point", number(settings.point_s));
    words.push(...(settings.draws ? ["--draws", String(settings.draws)] : ["--k-error", number(settings.k_error)]));
    words.push("--delay-ms", number(settings.delay_ms), "--fps", number(settings.fps), "--noise-mm", number(settings.noise_mm), "--duration-s", number(settings.duration_s));
    if (settings.max_force_N !== null) words.push("--max-force-N", number(settings.max_force_N));
    return words.join(" ");
  }

  // The goal goes where the pointer is, or by the arrow keys.
  const drag = (event: PointerEvent): void => {
    if (!scene.beam || event.type === "pointermove" && !element.hasPointerCapture(event.pointerId)) return;
    const box = element.getBoundingClientRect();
    form.goal = plane.metres([event.clientX - box.left, event.clientY - box.top]);
  };
  element.addEventListener("pointerdown", (event) => { if (event.button === 0) { element.setPointerCapture(event.pointerId); drag(event); } });
  element.addEventListener("pointermove", drag);
  element.addEventListener("keydown", (event) => {
    if (!scene.beam || event.ctrlKey || event.metaKey) return;
    const far = scene.beam.length_m * (event.shiftKey ? 0.05 : event.altKey ? 0.001 : 0.01), [x, y] = scene.goal;
    const way = ({ ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] } as Record<string, Point>)[event.key];
    if (way) form.goal = [x + far * way[0], y + far * way[1]];
    else if (event.key === " ") run(!timer);
    else return;
    event.preventDefault();
  });
  element.addEventListener("focus", () => { scene.focus = element.matches(":focus-visible"); canvas.redraw(); });
  element.addEventListener("blur", () => { scene.focus = false; canvas.redraw(); });

  atEnd(listen((message) => { void hear(message); }), onReturn(() => { void fill(); }), () => { run(false); clearTimeout(soon); canvas.end(); error.end(); force.end(); });
}
