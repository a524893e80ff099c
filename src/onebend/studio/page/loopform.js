import { digits, h } from "./dom.js";
const USUAL = { x: 0, y: 0, push: 1, point: 1, wrong: 30, draws: 3, delay: 50, fps: 30, noise: 0.05, last: 8 };
const BOUNDS = { x: [-1e6, 1e6], y: [-1e6, 1e6], push: [0.05, 1], point: [0.05, 1], wrong: [0, 95], draws: [1, 8], delay: [0, 10_000],
    fps: [0.1, 1000], noise: [0, 1000], last: [2, 600] };
const MOST_N = [1e-6, 1e6];
const range = ([least, most]) => `a number from ${least} to ${most}`;
export class SettingsForm {
    changed;
    element;
    given;
    fields = {};
    notes = new Map();
    length_m = Infinity;
    drawn;
    wrongly;
    most = h("input", { type: "number", min: MOST_N[0], max: MOST_N[1], step: "any", placeholder: "none", "aria-label": "largest force in N", input: () => this.changed() });
    band;
    constructor(at, changed) {
        this.changed = changed;
        this.given = at.has("x");
        const field = (key, says, step) => {
            const [min, max] = BOUNDS[key];
            return this.fields[key] = h("input", { type: "number", min, max, step, value: at.get(key) ?? USUAL[key], "aria-label": says, input: () => this.changed() });
        };
        const note = (input) => {
            const words = h("p", { class: "wrong", role: "alert", hidden: true });
            this.notes.set(input, words);
            return words;
        };
        const row = (words, input, unit) => h("div", {}, h("label", {}, h("span", {}, words), input, h("span", { class: "unit" }, unit)), note(input));
        this.wrongly = h("input", { type: "radio", name: "beams", checked: at.get("beams") !== "drawn", change: () => this.changed() });
        this.drawn = h("input", { type: "radio", name: "beams", checked: at.get("beams") === "drawn", change: () => this.changed() });
        this.band = h("label", { class: "either" }, this.drawn, h("span", {}, "drawn from its band"), field("draws", "beams that are drawn", 1), h("span", { class: "unit" }, "beams"));
        const wrong = field("wrong", "k is wrong by, in percent", "any"), draws = this.fields.draws;
        if (at.has("most"))
            this.most.value = at.get("most");
        this.element = h("section", { class: "settings" }, h("h2", {}, "Goal"), row("x", field("x", "goal, x in mm", "any"), "mm"), row("y", field("y", "goal, y in mm", "any"), "mm"), row("point s", field("point", "point that is led, s", 0.01), ""), row("force at s", field("push", "place of the force, s", 0.01), ""), h("h2", {}, "The true k(s) is"), h("label", { class: "either" }, this.wrongly, h("span", {}, "lower and higher by"), wrong, h("span", { class: "unit" }, "%")), note(wrong), this.band, note(draws), h("h2", {}, "The camera"), row("comes late by", field("delay", "delay in ms", "any"), "ms"), row("frames", field("fps", "frames a second", "any"), "1/s"), row("noise", field("noise", "noise in mm, one standard deviation", "any"), "mm"), h("h2", {}, "The robot"), row("largest force", this.most, "N"), row("it lasts", field("last", "duration in s", "any"), "s"));
    }
    number(key) {
        return this.fields[key].valueAsNumber;
    }
    wrong() {
        const found = new Map(), isDrawn = this.drawn.checked && !this.drawn.disabled;
        const within = (value, [least, most]) => value >= least && value <= most;
        for (const [key, field] of Object.entries(this.fields)) {
            const used = key === "draws" ? isDrawn : key === "wrong" ? !isDrawn : true, value = field.valueAsNumber;
            if (used && !(within(value, BOUNDS[key]) && (key !== "draws" || Number.isInteger(value))))
                found.set(field, range(BOUNDS[key]));
        }
        if ((this.most.value !== "" || this.most.validity.badInput) && !within(this.most.valueAsNumber, MOST_N))
            found.set(this.most, `${range(MOST_N)}, or empty: no limit`);
        const reach = this.length_m * this.number("point"), away = Math.hypot(this.number("x"), this.number("y")) / 1000;
        if (!found.size && away > reach)
            found.set(this.fields.x, `The goal is ${digits(1000 * away)} mm from the clamp: out of the beam's reach (${digits(1000 * reach)} mm).`);
        for (const [field, note] of this.notes) {
            const words = found.get(field) ?? "";
            field.setAttribute("aria-invalid", String(words !== ""));
            [field.title, note.textContent, note.hidden] = [words, words, !words];
        }
        const [first] = found.keys();
        return first?.getAttribute("aria-label") ?? "";
    }
    get goal() {
        const goal = [this.number("x") / 1000, this.number("y") / 1000];
        return goal.every(Number.isFinite) ? goal : null;
    }
    get values() {
        const most = this.most.valueAsNumber, metres = (key) => Number((this.number(key) / 1000).toFixed(6));
        return { goal_m: [metres("x"), metres("y")], push_s: this.number("push"), point_s: this.number("point"), k_error: this.number("wrong") / 100,
            draws: this.drawn.checked && !this.drawn.disabled ? this.number("draws") : 0, delay_ms: this.number("delay"), fps: this.number("fps"),
            noise_mm: this.number("noise"), duration_s: this.number("last"), max_force_N: Number.isFinite(most) ? most : null };
    }
    set goal([x, y]) {
        this.fields.x.value = String(Number((1000 * x).toFixed(2)));
        this.fields.y.value = String(Number((1000 * y).toFixed(2)));
        this.changed();
    }
    of(beam, goal) {
        this.length_m = beam.length_m;
        this.drawn.disabled = !beam.band;
        this.band.title = beam.band ? "" : "This result has no band.";
        if (!beam.band)
            this.wrongly.checked = true;
        if (!goal)
            this.goal = beam.goal_m;
    }
    adopt(values) {
        this.given = true;
        const put = { x: 1000 * values.goal_m[0], y: 1000 * values.goal_m[1], push: values.push_s, point: values.point_s, wrong: 100 * values.k_error,
            delay: values.delay_ms, fps: values.fps, noise: values.noise_mm, last: values.duration_s, ...(values.draws ? { draws: values.draws } : {}) };
        for (const [key, value] of Object.entries(put))
            this.fields[key].value = String(Number(value.toFixed(4)));
        (values.draws ? this.drawn : this.wrongly).checked = true;
        this.most.value = values.max_force_N === null ? "" : String(values.max_force_N);
    }
    kept(model) {
        const own = Object.fromEntries(Object.entries(this.fields).map(([key, field]) => [key, Number(field.value) === USUAL[key] ? "" : field.value]));
        return { model, ...own, x: this.fields.x.value, y: this.fields.y.value, beams: this.drawn.checked ? "drawn" : "", most: this.most.value };
    }
}
