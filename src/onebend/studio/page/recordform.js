import { h } from "./dom.js";
const FLAGS = { now: "film at once, whatever is wrong with the picture", no_learning: "learn no k(s) meanwhile", fast: "play as fast as it can be read", overwrite: "replace an earlier film there" };
const FLAG_NAMES = Object.keys(FLAGS);
const LONGEST = "600", CRF = "18";
let lists = 0;
export class Form {
    changed;
    element;
    out = text("folder to record into");
    like = h("select", { "aria-label": "the beam is that of" }, h("option", { value: "" }, "looking …"));
    camera = text("camera", "/dev/video0");
    force = text("force sensor", "none: film alone");
    until = number("how well k(s) is wanted, in percent", { min: 0.1, max: 100, step: "any", placeholder: "once" });
    longest = number("longest film in s", { min: 1, step: "any", placeholder: LONGEST });
    crf = number("CRF of H.264", { min: 0, max: 40, step: 1, placeholder: CRF });
    flags = Object.fromEntries(FLAG_NAMES.map((name) => [name, h("input", { type: "checkbox" })]));
    says = { camera: h("small", { class: "quiet" }), force: h("small", { class: "quiet" }) };
    lists;
    sources = null;
    names = new Set();
    wantedLike;
    constructor(at, changed, start) {
        this.changed = changed;
        const list = (input) => {
            const id = `sources-${++lists}`;
            input.setAttribute("list", id);
            return h("datalist", { id });
        };
        this.lists = { out: list(this.out), camera: list(this.camera), force: list(this.force) };
        this.wantedLike = at.get("like") ?? "";
        for (const [name, input] of [["out", this.out], ["camera", this.camera], ["force", this.force], ["until", this.until], ["longest", this.longest], ["crf", this.crf]])
            input.value = at.get(name) ?? "";
        if (this.out.value)
            this.out.dataset.own = "yes";
        for (const name of FLAG_NAMES)
            this.flags[name].checked = at.get(name) === "yes";
        const flag = (name) => h("label", { class: "check" }, this.flags[name], FLAGS[name]);
        this.element = h("form", { submit: (event) => { event.preventDefault(); start(this.wanted()); } }, h("h2", {}, "Record a push"), h("label", { class: "wide" }, h("span", {}, "into"), this.out), h("label", { class: "wide" }, h("span", {}, "copy recording.toml of"), this.like), h("label", { class: "wide" }, h("span", {}, "camera"), this.camera), this.says.camera, h("label", { class: "wide" }, h("span", {}, "force"), this.force), this.says.force, h("label", { class: "wide" }, h("span", {}, "until ± %"), this.until), flag("fast"), h("details", { open: FLAG_NAMES.some((name) => name !== "fast" && this.flags[name].checked) }, h("summary", {}, "more"), flag("now"), flag("no_learning"), flag("overwrite"), h("label", { class: "wide" }, h("span", {}, "at most [s]"), this.longest), h("label", { class: "wide" }, h("span", {}, "CRF"), this.crf)), h("button", { type: "submit", class: "main" }, "Record"), ...Object.values(this.lists));
        this.out.addEventListener("input", () => { this.out.dataset.own = this.out.value ? "yes" : ""; });
        this.like.addEventListener("input", () => { this.wantedLike = this.like.value; });
        this.element.addEventListener("input", () => this.refresh());
    }
    again(name) {
        this.wantedLike = name;
        this.out.dataset.own = "";
        this.refresh();
        this.out.focus();
    }
    used(name) {
        if (plain(this.out.value) !== name)
            return;
        this.wantedLike = this.out.value;
        this.out.dataset.own = "";
        this.refresh();
    }
    fill(sources, names) {
        [this.sources, this.names] = [sources, names];
        const options = (list, values) => list.replaceChildren(...values.map((value) => h("option", { value })));
        const [video, other] = [sources.devices.filter((one) => one.includes("/video")), sources.devices.filter((one) => !one.includes("/video"))];
        options(this.lists.out, sources.begun);
        options(this.lists.camera, [...video, ...sources.films.map((name) => `film:${name}`), ...sources.cameras.map((one) => one.example)]);
        options(this.lists.force, [...other.map((one) => `serial:${one},columns=fx_N/fy_N`), ...sources.logs.map((name) => `log:${name}`), ...sources.forces.map((one) => one.example)]);
        if (!this.camera.value && video[0])
            this.camera.value = video[0];
        if (!this.wantedLike && !this.out.value && !sources.begun.length)
            this.wantedLike = sources.films[0] ?? "";
        this.refresh();
    }
    refresh() {
        const { sources } = this;
        if (sources) {
            if (!this.out.dataset.own)
                this.out.value = this.wantedLike ? this.free(this.wantedLike) : sources.begun[0] ?? "";
            const own = this.names.has(this.out.value);
            this.like.replaceChildren(h("option", { value: "" }, own ? "its own recording.toml" : "choose a recording"), ...(own ? [] : [...new Set([...sources.films, ...sources.begun])].map((name) => h("option", { value: name, selected: name === this.wantedLike }, name))));
            this.like.disabled = own;
            for (const [input, kinds, says] of [[this.camera, sources.cameras, this.says.camera], [this.force, sources.forces, this.says.force]])
                says.textContent = kindOf(input.value, kinds);
        }
        const played = this.camera.value.startsWith("film:");
        this.flags.fast.closest("label").hidden = !played;
        if (!played)
            this.flags.fast.checked = false;
        this.changed(this.choice(), this.command());
    }
    free(like) {
        const begin = like.replace(/-\d+$/, ""), taken = (name) => this.names.has(name) && !this.sources.begun.includes(name);
        let n = 2;
        while (taken(`${begin}-${n}`))
            n++;
        return `${like === "." ? "push" : begin}-${n}`;
    }
    choice() {
        const flags = Object.fromEntries(FLAG_NAMES.map((name) => [name, this.flags[name].checked ? "yes" : ""]));
        const own = this.out.dataset.own ? this.out.value : "";
        return { out: own, like: this.wantedLike, camera: this.camera.value, force: this.force.value, until: this.until.value, longest: this.longest.value, crf: this.crf.value, ...flags };
    }
    wanted() {
        const flags = Object.fromEntries(FLAG_NAMES.map((name) => [name, this.flags[name].checked])), some = (input) => input.value ? { value: input.valueAsNumber } : {};
        const numbers = Object.fromEntries([["until_percent", this.until], ["longest_s", this.longest], ["crf", this.crf]].filter(([, input]) => input.value).map(([name, input]) => [name, some(input).value]));
        return { out: this.out.value, like: this.like.value, camera: this.camera.value, force: this.force.value, ...numbers, ...flags };
    }
    command() {
        if (!this.camera.value || !this.out.value)
            return "";
        const quoted = (word) => /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
        const given = [["camera", this.camera.value], ["force", this.force.value], ["like", plain(this.like.value)]].flatMap(([name, value]) => value ? [`--${name}`, value] : []);
        const numbers = [...(this.until.value ? ["--until", `${this.until.value}%`] : []), ...(this.longest.value && this.longest.value !== LONGEST ? ["--longest-s", this.longest.value] : []),
            ...(this.crf.value && this.crf.value !== CRF ? ["--crf", this.crf.value] : [])];
        const flags = FLAG_NAMES.filter((name) => this.flags[name].checked).map((name) => `--${name.replace("_", "-")}`);
        return ["onebend", "record", plain(this.out.value), ...given, ...numbers, ...flags].map(quoted).join(" ");
    }
}
const plain = (name) => name.startsWith("-") ? `./${name}` : name;
function kindOf(spec, kinds) {
    const head = spec.startsWith("/dev/video") ? "/dev/video" : `${spec.split(":")[0]}:`, kind = spec.includes(":") || head === "/dev/video" ? kinds.find((one) => one.example.startsWith(head)) : undefined;
    return kind ? `${kind.says}${kind.keys.length ? `; keys: ${kind.keys.join(", ")}` : ""}` : "";
}
const text = (label, placeholder = "") => h("input", { type: "text", spellcheck: "false", autocomplete: "off", "aria-label": label, placeholder });
const number = (label, more) => h("input", { type: "number", "aria-label": label, ...more });
