// The room Learn: recordings to learn from, how far it is, and what came out, one result or several.
import { coded, commandLine, digits, h } from "./dom.js";
import { Curve, CurveView, tintOf } from "./curve.js";
import { Film, FilmView } from "./film.js";
import { ask, listen, Message, onReturn, post, say } from "./net.js";
import { atEnd, remember } from "./place.js";

interface Found { name: string; kind: "recording" | "result"; changed: number; grade?: string; known?: string }
interface Stage { stage: string; done: number; total: number | null }
interface Job { recordings: string[]; out: string; command: string; seconds: number; stages: Stage[]; state: string; error: string; published: boolean }
interface Verdict { grade: string; headline: string; known: string; rests_on: string; use: string; narrower: string; next: string; docs: string }
interface Compared { recording: string; tag: number[]; s: number[]; rms_m: (number | null)[]; sensor_rms_m: (number | null)[] }
interface Result {
  name: string; length_m: number; curve: Curve; verdict: Verdict | null; training: Compared[]; validation: Compared[]; changed: string[];
  remarks: { recording: string; text: string; docs?: string }[]; command: string[] | null; written: string | null; report: boolean;
}

const MOST = 4;  // results over one another: there are as many colours
const WORDS: [keyof Verdict, string][] = [["known", "k(s)"], ["rests_on", "tests"], ["use", "accuracy"], ["narrower", "improve"], ["next", "next"]];

export function learn(place: HTMLElement, at: URLSearchParams): void {
  const curve = new CurveView(), film = new FilmView((frame) => { shownFrame = frame; keep(); });
  const recordings = h("ul", { class: "choice" }), results = h("ul", { class: "choice" }), progress = h("section", { class: "job", hidden: true });
  const out = h("input", { type: "text", spellcheck: "false", "aria-label": "folder for the result" });
  const replace = h("input", { type: "checkbox" }), start = h("button", { type: "submit", class: "main" }, "Learn k(s)");
  const doing = commandLine(), shown = h("section", { class: "results" }), words = h("div", { class: "verdict" });
  const known = new Map<string, Result>(), clock = h("small", { class: "quiet" }), timer = window.setInterval(tick, 1000);
  let chosen = (at.get("results") ?? "").split(",").filter(Boolean), shownFrame: number | null = at.has("frame") ? Number(at.get("frame")) : null;
  let from = (at.get("from") ?? "").split(",").filter(Boolean), check = (at.get("check") ?? "").split(",").filter(Boolean), job: Job | null = null, filmOf = "", begun = 0;

  const form = h("form", { submit: (event: Event) => { event.preventDefault(); void begin(); } },
    h("h2", {}, "Recordings"), recordings, h("label", { class: "wide" }, h("span", {}, "result in"), out),
    h("label", { class: "check" }, replace, "replace an earlier result there"), start);
  place.append(h("aside", { class: "side" }, form, progress, h("section", {}, h("h2", {}, "Results"), results)), shown);
  out.addEventListener("change", command);
  out.addEventListener("input", () => {
    if (out.value.trim()) out.dataset.own = "yes";
    else delete out.dataset.own;
    command();
  });
  replace.addEventListener("change", command);

  function keep(): void {
    remember("learn", { results: chosen.join(","), from: from.join(","), check: check.join(","), frame: chosen.length === 1 && shownFrame !== null ? String(shownFrame) : "" });
  }

  function command(): void {
    const usual = from[0] ? `${from[0] === "." ? "beam" : from[0].replace(/\/$/, "")}-results` : "";
    out.placeholder = usual;  // what an emptied field means
    if (!out.dataset.own && document.activeElement !== out) out.value = usual;
    const quoted = (word: string): string => /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
    const line = ["onebend", "learn", ...from, "--output", out.value.trim() || usual, ...check.flatMap((one) => ["--validate", one]), ...(replace.checked ? ["--force"] : [])];
    doing.set(from.length ? line.map(quoted).join(" ") : "");
    start.disabled = !from.length || job?.state === "running" || job?.state === "stopping";
    keep();
  }

  async function begin(): Promise<void> {
    say("");
    try {
      await post("/api/learn", { recordings: from, validate: check, out: out.value.trim() || out.placeholder, replace: replace.checked });
    } catch (error) {
      say((error as Error).message);
    }
  }

  async function fill(): Promise<void> {
    const { found } = await ask<{ found: Found[] }>("/api/places");
    const films = found.filter((one) => one.kind === "recording"), beams = found.filter((one) => one.kind === "result").sort((a, b) => b.changed - a.changed);
    from = from.filter((name) => films.some((one) => one.name === name));
    check = check.filter((name) => films.some((one) => one.name === name));
    recordings.replaceChildren(...films.map(({ name }) => h("li", {}, h("label", { class: "check" },
      h("input", { type: "checkbox", checked: from.includes(name), change: (event: Event) => toggle(event, name, true) }), h("span", {}, name)),
      h("label", { class: "check quiet", title: "compare the learned beam with this recording" },
        h("input", { type: "checkbox", checked: check.includes(name), "aria-label": `validate on ${name}`, change: (event: Event) => toggle(event, name, false) }), "validate on"))));
    if (!films.length) recordings.append(h("li", { class: "quiet" }, h("span", {}, "No folder with a recording.toml here. Begin one with ", h("code", {}, "onebend new"), ".")));
    if (!chosen.length && beams[0]) chosen = [beams[0].name];
    chosen = chosen.filter((name) => beams.some((one) => one.name === name));
    results.replaceChildren(...beams.map((one) => h("li", {}, h("label", { class: "check" },
      h("input", { type: "checkbox", checked: chosen.includes(one.name), change: (event: Event) => compare(event, one.name) }),
      h("span", {}, one.name, h("small", { class: one.grade === "not to be trusted" ? "warning" : "quiet" }, one.grade ?? ""))))));
    command();
    await draw();
  }

  function toggle(event: Event, name: string, learned: boolean): void {
    const on = (event.target as HTMLInputElement).checked;
    if (learned) from = on ? [...from, name] : from.filter((one) => one !== name);
    else check = on ? [...check, name] : check.filter((one) => one !== name);
    command();
  }

  function compare(event: Event, name: string): void {
    const box = event.target as HTMLInputElement;
    if (box.checked && chosen.length >= MOST) {
      box.checked = false;
      say(`At most ${MOST} results over one another: take one away first.`);
      return;
    }
    chosen = box.checked ? [...chosen, name] : chosen.filter((one) => one !== name);
    shownFrame = null;
    keep();
    void draw();
  }

  async function draw(): Promise<void> {
    const broken: string[] = [];
    for (const name of chosen) {
      if (known.has(name)) continue;
      try {
        known.set(name, await ask<Result>("/api/result", { name }));
      } catch (error) {
        broken.push((error as Error).message);
      }
    }
    const seen = chosen.map((name) => known.get(name)).filter((one): one is Result => one !== undefined);
    shown.replaceChildren(doing.element, ...broken.map((text) => h("p", { class: "warning", role: "alert" }, ...coded(text))), ...(seen.length || broken.length ? [] : [h("p", { class: "empty quiet" }, "Choose a recording and learn it, or a result to look at.")]));
    if (!seen.length) return;
    shown.append(h("h1", {}, seen.length === 1 ? ["k(s) of ", seen[0]!.name].join("") : `${seen.length} results compared`), curve.element, words, film.element);
    curve.set(seen.map((one) => ({ name: one.name, curve: one.curve, length_m: one.length_m, tags: one.training[0]?.s ?? [] })));
    words.replaceChildren(...(seen.length === 1 ? verdict(seen[0]!) : [comparison(seen)]));
    await showFilm(seen.length === 1 ? seen[0]! : null);
  }

  async function showFilm(result: Result | null): Promise<void> {
    if (!result?.report) {
      filmOf = "";
      film.set(null, null);
      return;
    }
    if (filmOf === result.name) return;
    filmOf = result.name;
    const found = await ask<Film | null>("/api/film", { name: result.name });
    if (filmOf === result.name) film.set(found, shownFrame);
  }

  function showJob(now: Job | null): void {
    job = now;
    progress.hidden = !now;
    if (!now) return;
    begun = Date.now() - 1000 * now.seconds;
    tick();
    const busy = now.state === "running" || now.state === "stopping";
    progress.replaceChildren(h("h2", {}, busy ? `Learning ${now.recordings.join(", ")}` : { done: "Learned", stopped: "Stopped", failed: "Not learned" }[now.state] ?? now.state,
      " ", clock),
      h("ol", {}, ...(now.stages.length ? [] : [stage({ stage: "starting", done: 0, total: null }, busy)]), ...now.stages.map((one, i) => stage(one, busy && i === now.stages.length - 1))));
    if (now.error && now.state === "failed") progress.append(h("p", { class: "warning" }, now.error));
    if (busy) progress.append(h("button", { type: "button", disabled: now.state === "stopping", click: () => { void post("/api/stop", {}); } }, now.state === "stopping" ? "stopping …" : "Stop"));
    if (now.state === "done") progress.append(h("a", { href: `#bend?model=${encodeURIComponent(now.out)}` }, "Bend it"));
    command();
  }

  function tick(): void {
    if (job) clock.textContent = `${Math.round(job.state === "running" || job.state === "stopping" ? (Date.now() - begun) / 1000 : job.seconds)} s`;
  }

  function hear(message: Message): void {
    if (message.what === "hello") showJob(message.job as Job | null);
    if (message.what === "job") {
      const before = job, now = message.job as Job, there = (one: Job | null): string => one === null ? "" : `${one.published} ${one.state === "done"}`;
      showJob(now);
      if (now.published && before && there(now) !== there(before)) {
        known.delete(now.out);
        filmOf = "";
        chosen = [now.out];
        shownFrame = null;
      }
    }
    if (message.what === "places") void fill();
  }

  atEnd(listen(hear), onReturn(() => { void fill(); void ask<{ job: Job | null }>("/api/job").then((one) => showJob(one.job)); }), () => curve.canvas.end(), () => film.end(), () => window.clearInterval(timer));
}

function stage({ stage: words, done, total }: Stage, busy: boolean): HTMLElement {
  const share = total ? Math.min(done / total, 1) : busy ? 0 : 1;
  return h("li", { class: busy ? "busy" : "" }, h("span", {}, words), h("span", { class: "quiet" }, total && busy ? `${done} of ${total}` : busy ? `${done || ""} …` : "✓"),
    h("progress", { max: 1, ...(busy && !total ? {} : { value: busy ? share : 1 }) }));
}

function verdict(result: Result): Node[] {
  const { verdict: said } = result, rows: Node[] = [];
  if (said) {
    rows.push(h("p", { class: said.grade === "not to be trusted" ? "headline warning" : "headline" }, h("b", {}, ...coded(said.headline))));
    rows.push(h("dl", { class: "words" }, ...WORDS.filter(([key]) => said[key]).flatMap(([key, label]) => [h("dt", {}, label), h("dd", { class: key }, ...coded(said[key]))])));
  }
  for (const one of result.changed) rows.push(h("p", { class: "warning" }, `model.json ${one}`));
  if (result.remarks.length) rows.push(h("ul", { class: "remarks" }, ...result.remarks.map((one) => h("li", { class: "warning" }, `${one.recording}: `, ...coded(one.text)))));
  const errors = [...result.training.map((one) => ["learned from", one] as const), ...result.validation.map((one) => ["validated on", one] as const)];
  rows.push(h("div", { class: "scroll" }, h("table", {}, h("tr", {}, h("th", {}, ""), h("th", {}, "recording"), ...(errors[0]?.[1].tag ?? []).map((tag) => h("th", {}, `tag ${tag} [mm]`))),
    ...errors.map(([how, one]) => h("tr", {}, h("td", { class: "quiet" }, how), h("td", {}, one.recording),
      ...one.rms_m.map((rms, i) => h("td", { class: "number", title: "RMS under the force as logged; in brackets what its noise alone would do" }, digits(1000 * (rms ?? NaN)),
        h("span", { class: "quiet" }, ` (${digits(1000 * (one.sensor_rms_m[i] ?? NaN), 2)})`))))))));
  rows.push(h("p", { class: "links" }, h("a", { href: `#bend?model=${encodeURIComponent(result.name)}`, class: "button" }, "Bend it"),
    result.written && h("span", { class: "quiet" }, `written ${new Date(result.written).toLocaleString()}`)));
  return rows;
}

function comparison(results: Result[]): HTMLElement {
  const half = (one: Result, s: number): string => {
    const i = Math.round(s * (one.curve.s.length - 1)), band = one.curve.bands[0];
    return band ? ` ± ${digits(100 * (Math.sqrt(band.high_N_m[i]! / band.low_N_m[i]!) - 1), 2)} %` : "";
  };
  const places = [0, 0.25, 0.5, 0.75, 1];
  return h("div", { class: "scroll" }, h("table", {}, h("tr", {}, h("th", {}, "k [N m] at"), ...places.map((s) => h("th", {}, `s = ${s}`)), h("th", {}, "verdict")),
    ...results.map((one, n) => h("tr", {}, h("td", {}, h("i", { class: `dot ${tintOf(n)}` }), one.name),
      ...places.map((s) => h("td", { class: "number" }, digits(one.curve.k_N_m[Math.round(s * (one.curve.s.length - 1))]), h("span", { class: "quiet" }, half(one, s)))),
      h("td", { class: one.verdict?.grade === "not to be trusted" ? "warning" : "" }, one.verdict?.grade ?? "")))));
}
