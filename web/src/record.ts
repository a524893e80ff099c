// The room Record: a push that is filmed and logged, guided from rest to rest. It goes on whoever looks on.
import { coded, commandLine, digits, h } from "./dom.js";
import { Choice, Form, Sources } from "./recordform.js";
import { Live, Recording } from "./recordlive.js";
import { ask, listen, Message, onReturn, post, say } from "./net.js";
import { atEnd, remember } from "./place.js";

const ENDS: Record<string, string> = { done: "Recorded", failed: "Not recorded:", broken: "Ended early:", checking: "Recorded", stopping: "Ending", starting: "Opening camera and sensor for", recording: "Recording" };
const going = (one: Recording | null): boolean => one !== null && ["starting", "recording", "stopping", "checking"].includes(one.phase);

export function record(place: HTMLElement, at: URLSearchParams): void {
  const form = new Form(at, changed, (wanted) => { void begin(wanted); }), live = new Live(), doing = commandLine();
  const title = h("h1", { tabindex: -1 }), ended = h("section", { class: "ended" });
  const film = h("button", { type: "button", click: () => { void ordered("begin"); } }, "Film as it is");
  const stop = h("button", { type: "button", class: "main", click: () => { void ordered("stop"); } });
  const orders = h("p", { class: "links" }, film, stop);
  const hint = h("div", { class: "empty quiet" }, h("p", {}, "Choose the beam, a camera and a force sensor. Then do what the page says: from rest, to push, to rest."),
    h("p", {}, "The beam is described by a recording.toml: that of another push, or one that ", h("code", {}, "onebend new"), " begins and you fill in."),
    h("p", {}, "Without a camera: choose a recording as the camera. Its film and its log are played."));
  let recording: Recording | null = null, told = "";
  place.append(h("aside", { class: "side" }, form.element, live.numbers), h("section", { class: "filming" }, doing.element, hint, title, live.stages, live.advice, orders, live.picture, live.curve.element, ended));

  function changed(choice: Choice, command: string): void {
    remember("record", { ...choice });
    if (!going(recording)) doing.set(command);
  }

  async function begin(wanted: Record<string, unknown>): Promise<void> {
    say("");
    try {
      await post("/api/record/start", wanted);
      title.focus();
    } catch (error) {
      say((error as Error).message);
    }
  }

  async function ordered(what: string): Promise<void> {
    await post(`/api/record/${what}`, {});
  }

  function show(now: Recording | null): void {
    const before = recording;
    recording = now;
    const on = going(now);
    hint.hidden = title.hidden = live.stages.hidden = now === null;
    hint.hidden = now !== null;
    form.element.hidden = on;
    live.show(now, on);
    orders.hidden = !on;
    if (!now) return;
    title.textContent = `${ENDS[now.phase === "failed" && now.state.frames ? "broken" : now.phase]} ${now.out}`;
    film.hidden = now.phase !== "recording" || now.state.stage !== 0;
    stop.disabled = now.phase === "stopping" || now.phase === "checking";
    stop.textContent = now.phase === "checking" ? "checking …" : now.phase === "stopping" ? "ending …" : now.state.stage ? "Finish: keep what there is" : "Stop";
    if (on) doing.set(now.command);
    else if (going(before)) form.refresh();
    const ending = JSON.stringify([now.out, now.phase, now.outcome, now.check, now.error]);
    if (ending === told) return;
    told = ending;
    if (!on && now.outcome?.begun) form.used(now.out);
    ended.replaceChildren(...(on && now.phase !== "checking" ? [] : outcome(now)));
  }

  function outcome(one: Recording): Node[] {
    const { outcome: left, check } = one, nodes: (Node | null)[] = [];
    if (one.error) nodes.push(h("p", { class: "warning" }, ...coded(one.error)));
    if (left) nodes.push(h("p", { class: left.fault || !left.begun ? "headline warning" : "headline" }, h("b", {}, sentence(left.ended)), left.begun && !left.fault ? ` ${known(one)}` : ""));
    if (left?.begun) nodes.push(h("p", { class: "quiet" }, `${left.seconds.toFixed(1)} s, ${left.frames} frames${left.frames_missing ? `, ${left.frames_missing} missing` : ""}${left.log ? `, ${left.samples} samples of the force` : ""}`));
    if (left?.remarks.length) nodes.push(h("ul", { class: "remarks" }, ...left.remarks.map((words) => h("li", { class: "warning" }, sentence(words)))));
    if (left?.begun) {
      nodes.push(h("h2", {}, check ? "Result of the check" : "Checking …"));
      if (check) nodes.push(...checked(check));
    }
    if (!going(one) && (left?.begun || !left && one.state.frames)) {
      nodes.push(h("p", { class: "links" }, h("a", { class: "button main", href: `#learn?${new URLSearchParams({ from: one.out })}` }, "Learn it"),
        h("button", { type: "button", click: () => form.again(one.out) }, "Another push of this beam")));
    }
    return nodes.filter((node): node is Node => node !== null);
  }

  async function fill(): Promise<void> {
    const [sources, found] = await Promise.all([ask<Sources>("/api/record/sources"), ask<{ found: { name: string }[] }>("/api/places")]);
    form.fill(sources, new Set(found.found.map((one) => one.name)));
  }

  function hear(message: Message): void {
    if (message.what === "hello" || message.what === "recording") show(message.recording as Recording | null);
    if (message.what === "places") void fill();
  }

  show(null);
  atEnd(listen(hear), onReturn(() => { void fill(); void ask<{ recording: Recording | null }>("/api/record").then((one) => show(one.recording)); }), () => live.end());
}

function checked({ rows, remarks, faults }: NonNullable<Recording["check"]>): Node[] {
  return [
    ...faults.map((words) => h("p", { class: "warning" }, ...coded(words))),
    h("dl", { class: "words" }, ...rows.flatMap(([what, words]) => [h("dt", {}, what), h("dd", {}, words)])),
    h("ul", { class: "remarks" }, ...remarks.map(({ level, text }) => h("li", { class: level }, ...coded(text)))),
  ];
}

// What is known of k(s) when the film is over. Doubts of a push that went on are none of the whole.
function known({ state, curve }: Recording): string {
  const width = state.half_width ?? null;
  if (width !== null) return `k(s) was known to ± ${digits(100 * width, 2)} % (95 %, median) by then; learning takes all frames together.`;
  return curve ? "k(s) was not known by then; learning takes all frames together." : "";
}

const sentence = (words: string): string => words && `${words.charAt(0).toUpperCase()}${words.slice(1)}${/[.?!]$/.test(words) ? "" : "."}`;
