// What is to be recorded: the beam, the camera, the force sensor, and how, as `onebend record` takes them.
import { h } from "./dom.js";

export interface Kind { example: string; says: string; keys: string[] }
export interface Sources { cameras: Kind[]; forces: Kind[]; devices: string[]; films: string[]; logs: string[]; begun: string[] }
export type Choice = Record<"out" | "like" | "camera" | "force" | "until" | "longest" | "crf" | Flag, string>;

const FLAGS = { now: "film at once, whatever is wrong with the picture", no_learning: "learn no k(s) meanwhile", fast: "play as fast as it can be read", overwrite: "replace an earlier film there" };
type Flag = keyof typeof FLAGS;
const FLAG_NAMES = Object.keys(FLAGS) as Flag[];
const LONGEST = "600", CRF = "18";  // the command's own

export class Form {
  readonly element: HTMLFormElement;
  private readonly out = text("folder to record into");
  private readonly like = h("select", { "aria-label": "the beam is that of" }, h("option", { value: "" }, "looking …"));
  private readonly camera = new Source("camera", "choose a camera");
  private readonly force = new Source("force sensor", "none: film alone");
  private readonly until = number("how well k(s) is wanted, in percent", { min: 0.1, max: 100, step: "any", placeholder: "once" });
  private readonly longest = number("longest film in s", { min: 1, step: "any", placeholder: LONGEST });
  private readonly crf = number("CRF of H.264", { min: 0, max: 40, step: 1, placeholder: CRF });
  private readonly flags = Object.fromEntries(FLAG_NAMES.map((name) => [name, h("input", { type: "checkbox" })])) as Record<Flag, HTMLInputElement>;
  private readonly begun = h("datalist", { id: "begun" });
  private sources: Sources | null = null;
  private names = new Set<string>();
  private wantedLike: string;
  private likeChosen: boolean;  // by hand, or by the address

  constructor(at: URLSearchParams, private readonly changed: (choice: Choice, command: string) => void, start: (wanted: Record<string, unknown>) => void) {
    this.out.setAttribute("list", this.begun.id);
    this.wantedLike = at.get("like") ?? "";
    this.likeChosen = this.wantedLike !== "";
    for (const [name, input] of [["out", this.out], ["camera", this.camera], ["force", this.force], ["until", this.until], ["longest", this.longest], ["crf", this.crf]] as const) input.value = at.get(name) ?? "";
    if (this.out.value) this.out.dataset.own = "yes";
    for (const name of FLAG_NAMES) this.flags[name].checked = at.get(name) === "yes";
    const flag = (name: Flag): HTMLElement => h("label", { class: "check" }, this.flags[name], FLAGS[name]);
    this.element = h("form", { submit: (event: Event) => { event.preventDefault(); start(this.wanted()); } },
      h("h2", {}, "Record a push"),
      h("label", { class: "wide" }, h("span", {}, "into"), this.out), h("label", { class: "wide" }, h("span", {}, "same beam as"), this.like),
      this.camera.element, this.force.element,
      h("label", { class: "wide" }, h("span", {}, "until ± %"), this.until), flag("fast"),
      h("details", { open: FLAG_NAMES.some((name) => name !== "fast" && this.flags[name].checked) }, h("summary", {}, "more"), flag("now"), flag("no_learning"), flag("overwrite"),
        h("label", { class: "wide" }, h("span", {}, "at most [s]"), this.longest), h("label", { class: "wide" }, h("span", {}, "CRF"), this.crf)),
      h("button", { type: "submit", class: "main" }, "Record"), this.begun);
    this.out.addEventListener("input", () => { this.out.dataset.own = this.out.value ? "yes" : ""; });
    this.like.addEventListener("input", () => { this.wantedLike = this.like.value; this.likeChosen = true; });  // before the form makes its options anew
    this.camera.list.addEventListener("input", () => this.played());
    this.element.addEventListener("input", () => this.refresh());
  }

  // The next push of the beam of a recording.
  again(name: string): void {
    this.wantedLike = name;
    this.likeChosen = true;
    this.out.dataset.own = "";
    this.refresh();
    this.out.focus();
  }

  // A folder that holds a recording now: the next push goes to another one.
  used(name: string): void {
    if (plain(this.out.value) !== name) return;
    this.wantedLike = this.out.value;
    this.out.dataset.own = "";
    this.refresh();
  }

  fill(sources: Sources, names: Set<string>): void {
    [this.sources, this.names] = [sources, names];
    const [video, other] = [sources.devices.filter((one) => one.includes("/video")), sources.devices.filter((one) => !one.includes("/video"))];
    this.begun.replaceChildren(...sources.begun.map((value) => h("option", { value })));
    this.camera.fill({ "on this computer": video.map((one) => [one, one]), "a recording, played": sources.films.map((name) => [`film:${name}`, name]) }, sources.cameras);
    this.force.fill({ "a recording, played": sources.logs.map((name) => [`log:${name}`, name]) }, [...other.map((one) => ({ example: `serial:${one},columns=fx_N/fy_N`, says: `a load cell at ${one}`, keys: [] })), ...sources.forces]);
    if (!this.camera.value && video[0]) this.camera.value = video[0];
    if (!this.wantedLike && !this.out.value && !sources.begun.length) this.wantedLike = sources.films[0] ?? "";
    this.refresh();
  }

  refresh(): void {
    const { sources } = this;
    if (sources) {
      if (!this.out.dataset.own) this.out.value = this.wantedLike ? this.free(this.wantedLike) : sources.begun[0] ?? "";
      const own = this.names.has(this.out.value);  // it has a recording.toml already
      this.like.replaceChildren(h("option", { value: "" }, own ? "its own recording.toml" : "choose a recording"),
        ...(own ? [] : [...new Set([...sources.films, ...sources.begun])].map((name) => h("option", { value: name, selected: name === this.wantedLike }, name))));
      this.like.disabled = own;
      this.camera.refresh(sources.cameras);
      this.force.refresh(sources.forces);
    }
    const played = this.camera.value.startsWith("film:");
    this.flags.fast.closest("label")!.hidden = !played;
    if (!played) this.flags.fast.checked = false;
    this.changed(this.choice(), this.command());
  }

  // A recording that is played gives its log and its beam too, where nothing else was chosen.
  private played(): void {
    const name = this.camera.value.startsWith("film:") ? this.camera.value.slice(5) : "";
    if (!name || !this.sources) return;
    if (/^(log:|$)/.test(this.force.value)) this.force.value = this.sources.logs.includes(name) ? `log:${name}` : "";
    if (!this.likeChosen) this.wantedLike = name;
  }

  // A name that is new, or that of a start that failed.
  private free(like: string): string {
    const begin = like.replace(/-\d+$/, ""), taken = (name: string): boolean => this.names.has(name) && !this.sources!.begun.includes(name);
    let n = 2;
    while (taken(`${begin}-${n}`)) n++;
    return `${like === "." ? "push" : begin}-${n}`;
  }

  private choice(): Choice {
    const flags = Object.fromEntries(FLAG_NAMES.map((name) => [name, this.flags[name].checked ? "yes" : ""])) as Record<Flag, string>;
    const own = this.out.dataset.own ? this.out.value : "";
    return { out: own, like: this.likeChosen ? this.wantedLike : "", camera: this.camera.value, force: this.force.value, until: this.until.value, longest: this.longest.value, crf: this.crf.value, ...flags };
  }

  private wanted(): Record<string, unknown> {
    const flags = Object.fromEntries(FLAG_NAMES.map((name) => [name, this.flags[name].checked])), some = (input: HTMLInputElement): Record<string, unknown> => input.value ? { value: input.valueAsNumber } : {};
    const numbers = Object.fromEntries(([["until_percent", this.until], ["longest_s", this.longest], ["crf", this.crf]] as const).filter(([, input]) => input.value).map(([name, input]) => [name, some(input).value]));
    return { out: this.out.value, like: this.like.value, camera: this.camera.value, force: this.force.value, ...numbers, ...flags };
  }

  private command(): string {
    if (!this.camera.value || !this.out.value) return "";
    const quoted = (word: string): string => /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
    const given = ([["camera", this.camera.value], ["force", this.force.value], ["like", plain(this.like.value)]] as const).flatMap(([name, value]) => value ? [`--${name}`, value] : []);
    const numbers = [...(this.until.value ? ["--until", `${this.until.value}%`] : []), ...(this.longest.value && this.longest.value !== LONGEST ? ["--longest-s", this.longest.value] : []),
      ...(this.crf.value && this.crf.value !== CRF ? ["--crf", this.crf.value] : [])];
    const flags = FLAG_NAMES.filter((name) => this.flags[name].checked).map((name) => `--${name.replace("_", "-")}`);
    return ["onebend", "record", plain(this.out.value), ...given, ...numbers, ...flags].map(quoted).join(" ");
  }
}

const OTHER = "\u0000";  // no spec

// What can be chosen; and its spec as text, for an address, a place, or keys behind commas.
class Source {
  readonly list: HTMLSelectElement;
  readonly element: HTMLElement;
  private readonly input: HTMLInputElement;
  private readonly says = h("small", { class: "quiet" });
  private typed = false;  // the text was asked for

  constructor(label: string, private readonly none: string) {
    this.input = text(`${label} as text`);
    this.list = h("select", { "aria-label": label, input: () => this.chosen() });
    this.element = h("div", {}, h("label", { class: "wide" }, h("span", {}, label.split(" ")[0]!), this.list), this.input, this.says);
    this.fill({}, []);
  }

  get value(): string {
    return this.input.value;
  }

  set value(spec: string) {
    this.input.value = spec;
    this.typed = false;
    this.refresh();
  }

  fill(groups: Record<string, [string, string][]>, kinds: Kind[]): void {
    const option = ([value, words]: [string, string], kind = ""): HTMLElement => h("option", { value, "data-kind": kind || null }, words);
    this.list.replaceChildren(option(["", this.none]),
      ...Object.entries(groups).filter(([, rows]) => rows.length).map(([label, rows]) => h("optgroup", { label }, ...rows.map((one) => option(one)))),
      h("optgroup", { label: "of another kind" }, ...kinds.map((one) => option([one.example, one.says.replace(/ \(pip .*\)/, "")], "yes")), option([OTHER, "as text"], "yes")));
    this.refresh();
  }

  refresh(kinds: Kind[] = []): void {
    const known = [...this.list.options].some((one) => one.value === this.input.value && !one.dataset.kind);
    this.list.value = known && !this.typed ? this.input.value : OTHER;
    this.input.hidden = known && !this.typed;
    this.says.textContent = this.input.hidden ? "" : kindOf(this.input.value, kinds);
  }

  private chosen(): void {
    const one = this.list.selectedOptions[0]!;
    this.typed = one.dataset.kind === "yes";
    if (this.list.value !== OTHER) this.input.value = this.list.value;
    this.refresh();
    if (this.typed) this.input.select();
  }
}

// A name that no command takes for an option.
const plain = (name: string): string => name.startsWith("-") ? `./${name}` : name;

// What the kind of source is, and the keys that may follow it.
function kindOf(spec: string, kinds: Kind[]): string {
  const head = spec.startsWith("/dev/video") ? "/dev/video" : `${spec.split(":")[0]}:`, kind = spec.includes(":") || head === "/dev/video" ? kinds.find((one) => one.example.startsWith(head)) : undefined;
  return kind ? `${kind.says}${kind.keys.length ? `; keys: ${kind.keys.join(", ")}` : ""}` : "";
}

const text = (label: string, placeholder = ""): HTMLInputElement => h("input", { type: "text", spellcheck: "false", autocomplete: "off", "aria-label": label, placeholder });
const number = (label: string, more: Record<string, string | number>): HTMLInputElement => h("input", { type: "number", "aria-label": label, ...more });
