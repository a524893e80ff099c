// Numbers and settings beside the plane of bending.
import { digits, fixed, h } from "./dom.js";
import { Answer, Opened, telling } from "./plane.js";

export class Panel {
  readonly modes: HTMLElement;
  readonly status = h("p", { class: "status", role: "status" });
  readonly element: HTMLElement;
  private readonly rows: Record<string, HTMLElement> = {};
  private readonly bar = h("i");
  private readonly point = h("input", { type: "range", min: 0.1, max: 1, step: 0.01, "aria-label": "point s" });
  private readonly push = h("input", { type: "range", min: 0.1, max: 1, step: 0.01, "aria-label": "force at s" });
  private readonly link = h("input", { type: "checkbox", checked: true });
  private readonly largest = h("input", { type: "number", min: 1e-6, max: 1e6, step: "any", "aria-label": "largest force in N" });
  private readonly wrong = h("p", { class: "wrong", role: "alert", hidden: true }, "a number from 0.000001 to 1000000: the last right one is in force");
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
    this.largest.addEventListener("input", () => this.judge());
    this.largest.addEventListener("change", () => { if (this.judge()) change({ max_force_N: this.largest.valueAsNumber }); });
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
      h("label", {}, h("span", {}, "largest force"), this.largest, h("span", { class: "unit" }, "N")), this.wrong,
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
    this.judge();
    for (const [name, button] of Object.entries(this.buttons)) button.setAttribute("aria-pressed", String(name === opened.mode));
    this.rows.moment!.closest<HTMLElement>(".row")!.hidden = !hand;
    this.rows.ellipse!.closest<HTMLElement>(".row")!.hidden = hand || !opened.band;
    this.doubts.hidden = !opened.doubts.length;
    this.doubts.textContent = opened.doubts.length ? `k(s) is not to be trusted: ${opened.doubts.join("; ")}` : "";
    this.element.classList.toggle("mapping", !hand);
  }

  // Whether the largest force can be taken; it is marked where not.
  private judge(): boolean {
    const value = this.largest.valueAsNumber, right = value >= 1e-6 && value <= 1e6;
    this.largest.setAttribute("aria-invalid", String(!right));
    this.largest.title = right ? "" : this.wrong.textContent!;
    this.wrong.hidden = right;
    return right;
  }

  // Nothing is known of a beam that is not open.
  clear(): void {
    for (const one of Object.values(this.rows)) one.textContent = "–";
    this.bar.style.width = "0";
    this.status.textContent = "";
    this.doubts.hidden = true;
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
    const beyond = answer.beyond_learned > 0;
    this.status.textContent = why(opened, answer) + (beyond ? `; ${digits(answer.beyond_learned)} times the largest force learned from` : "");
    this.status.className = answer.limit || beyond ? "status warning" : "status";
  }

  empty(): void {
    this.status.replaceChildren("No learned beam in this folder yet. ", h("a", { href: "#learn" }, "Learn a recording"), " first.");
  }
}

function why(opened: Opened, { limit, away_m, turned_away_rad }: Answer): string {
  if (!limit) return "on its goal";
  const away = away_m < 1e-5 ? `${fixed(Math.abs(180 * turned_away_rad / Math.PI), 1)}° from the angle` : `${digits(1000 * away_m)} mm from the goal`;
  const who = opened.mode === "hand" ? "hand" : "force";
  return limit === "stability" ? `edge of stability, ${away}` : `the ${who} would need more than ${digits(opened.max_force_N)} N, ${away}`;
}
