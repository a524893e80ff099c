import { CurveView } from "./curve.js";
import { digits, fixed, h } from "./dom.js";
import { Canvas, label, trace } from "./draw.js";
const SMALL = 20;
const ROWS = ["components", "tare", "tip", "tags", "film", "log", "clocks", "disk", "k"];
const WORDS = { components: "components", tare: "the tare", tip: "tip / length", k: "k(s)", tags: "tags", film: "film", log: "log", clocks: "clocks agree to", disk: "disk" };
export class Live {
    stages = h("ol", { class: "stages", "aria-label": "stages" });
    advice = h("div", { class: "advice" });
    picture;
    numbers;
    curve = new CurveView();
    said = h("p", { class: "heard", role: "status" });
    lines = h("ul");
    node = h("canvas", { role: "img", "aria-label": "the camera's picture with the tags and the outline that were found" });
    canvas;
    big = h("p", { class: "big" });
    rows = {};
    bar = h("i");
    kWords = h("p", { class: "quiet" });
    image = null;
    shown = null;
    number = 0;
    fetching = false;
    newest = null;
    drawn = null;
    constructor() {
        this.advice.append(this.lines, this.said);
        this.picture = h("figure", { class: "camera", hidden: true }, this.node);
        this.canvas = new Canvas(this.node, this.paint);
        this.curve.element.querySelector(".reading").setAttribute("aria-live", "off");
        const rows = ROWS.map((name) => {
            this.rows[name] = h("b");
            return h("div", { class: "row" }, h("dt", {}, WORDS[name]), h("dd", {}, this.rows[name]));
        });
        this.numbers = h("section", { class: "numbers", hidden: true }, h("h2", {}, "Force now"), this.big, h("dl", {}, ...rows), h("div", { class: "margin", title: "half the 95 % band of k(s); the narrower, the better" }, this.bar), this.kWords);
    }
    end() {
        this.canvas.end();
        this.curve.canvas.end();
    }
    show(now, on) {
        this.newest = now;
        const state = now?.state ?? {}, films = on && now?.phase !== "checking", begun = films && state.stage !== undefined;
        this.numbers.hidden = this.advice.hidden = !begun;
        this.stages.hidden = state.stage === undefined;
        this.picture.hidden = !films || !now?.picture;
        this.curve.element.hidden = !now?.curve || !films && state.half_width === null;
        if (!now || state.stage === undefined)
            return;
        const full = state;
        this.steps(full, on);
        if (begun) {
            this.tell(full);
            this.measured(full);
        }
        if (now.curve && now.curve !== this.drawn && JSON.stringify(now.curve) !== JSON.stringify(this.drawn)) {
            this.drawn = now.curve;
            this.curve.set([{ name: now.out, curve: now.curve, length_m: now.length_m, tags: full.tag_s }]);
        }
        if (begun)
            this.fetchPicture();
    }
    steps({ stages, stage }, on) {
        const mark = (i) => i < stage || stage === stages.length - 1 ? "done" : i > stage ? "later" : on ? "now" : "left";
        const key = `${stages.join()} ${stage} ${on}`;
        if (this.stages.dataset.key === key)
            return;
        this.stages.dataset.key = key;
        this.stages.replaceChildren(...stages.map((name, i) => h("li", { class: mark(i), "aria-current": i === stage ? "step" : null }, name)));
    }
    tell({ advice }) {
        const words = advice.join(". "), bare = words.replace(/[\d.]/g, "");
        if (this.lines.textContent !== advice.join(""))
            this.lines.replaceChildren(...advice.map((one) => h("li", {}, one)));
        if (this.said.dataset.bare !== bare) {
            this.said.dataset.bare = bare;
            this.said.textContent = words;
        }
    }
    measured(state) {
        const put = (name, words) => {
            this.rows[name].textContent = words;
            this.rows[name].closest(".row").hidden = words === "";
        };
        const [fx, fy] = state.force_N, [tx, ty] = state.tare_N, known = typeof fx === "number" && typeof fy === "number";
        this.big.replaceChildren(h("b", {}, known ? fixed(Math.hypot(fx, fy), 3) : "–"), " N");
        put("components", known ? `${fixed(fx, 3)}, ${fixed(fy, 3)} N` : "");
        put("tare", typeof tx === "number" && typeof ty === "number" ? `${fixed(tx, 3)}, ${fixed(ty, 3)} N` : "");
        put("tip", state.displacement === null ? "" : `${percent(state.displacement)}, most ${percent(state.largest)}`);
        put("k", state.half_width === null ? "" : `± ${digits(100 * state.half_width, 2)} %${state.until === null ? "" : `, wanted ± ${digits(100 * state.until, 2)} %`}`);
        put("tags", tagWords(state.tags));
        put("film", state.frames ? `${state.seconds.toFixed(1)} s, ${state.frames} frames${missing(state.drops)}, ${(state.bytes / 1e6).toFixed(1)} MB` : "not begun");
        put("log", state.samples ? `${state.samples} samples${missing(state.lost_samples)}` : "");
        put("clocks", state.samples && state.clock_sd_s !== null ? `${Math.max(1000 * state.clock_sd_s, 0.1).toFixed(1)} ms` : "");
        put("disk", state.disk_left === null ? "" : `${(state.disk_left / 1e9).toFixed(1)} GB left`);
        this.bar.parentElement.hidden = state.half_width === null;
        this.bar.style.width = `${100 * Math.min(state.half_width ?? 1, 1)}%`;
        this.bar.className = state.until !== null && (state.half_width ?? 1) > state.until ? "low" : "";
        this.kWords.textContent = state.half_width === null ? state.k_says : state.wider;
    }
    fetchPicture() {
        const now = this.newest;
        if (!now?.picture || now.picture === this.number || this.fetching)
            return;
        const image = new Image(), { size_px: size, tags, outline_px: outline } = now.state;
        this.number = now.picture;
        this.fetching = true;
        const over = () => {
            this.fetching = false;
            this.fetchPicture();
        };
        image.addEventListener("load", () => {
            this.image = image;
            this.shown = { size: size, tags, outline };
            this.node.style.aspectRatio = `${size[0]} / ${size[1]}`;
            this.canvas.redraw();
            over();
        });
        image.addEventListener("error", () => window.setTimeout(over, 500));
        image.src = `/api/record/picture?n=${now.picture}`;
    }
    paint = ({ context, width }, tint) => {
        if (!this.image || !this.shown)
            return;
        const { size: [wide, high], tags, outline } = this.shown, scale = width / wide;
        context.drawImage(this.image, 0, 0, width, scale * high);
        context.font = "600 12px system-ui, sans-serif";
        context.textAlign = "center";
        for (const [line, ink] of [[4, "#fff"], [2, "#2fb98c"]]) {
            context.lineWidth = line;
            context.strokeStyle = ink;
            for (const seen of stretches(outline)) {
                trace(context, seen.map(([x, y]) => [scale * (x + 0.5), scale * (y + 0.5)]));
                context.stroke();
            }
        }
        for (const { id, side_px, corners_px } of tags) {
            if (!corners_px)
                continue;
            const points = corners_px.map(([x, y]) => [scale * (x + 0.5), scale * (y + 0.5)]), colour = (side_px ?? 0) < SMALL ? "#e07b28" : "#2fb98c";
            for (const [line, ink] of [[4, "#fff"], [2, colour]]) {
                context.lineWidth = line;
                context.strokeStyle = ink;
                trace(context, points, true);
                context.stroke();
            }
            label(context, String(id), points.reduce((sum, [x]) => sum + x / 4, 0), Math.min(...points.map(([, y]) => y)) - 6, "#11161c", "#fff");
        }
        this.node.style.borderColor = tint.line;
    };
}
function stretches(outline) {
    const parts = [[]];
    for (const [x, y] of outline) {
        if (x === null || y === null)
            parts.push([]);
        else
            parts[parts.length - 1].push([x, y]);
    }
    return parts.filter((part) => part.length > 1);
}
function tagWords(tags) {
    const hidden = tags.filter((tag) => !tag.corners_px).map((tag) => tag.id), sides = tags.flatMap((tag) => tag.side_px ?? []);
    const smallest = sides.length ? `, smallest ${Math.min(...sides).toFixed(0)} px` : "";
    return tags.length ? `${tags.length - hidden.length} of ${tags.length}${smallest}${hidden.length ? `; not ${hidden.join(", ")}` : ""}` : "";
}
const percent = (share) => share === null ? "–" : `${(100 * share).toFixed(0)} %`;
const missing = (count) => count ? `, ${count} missing` : "";
