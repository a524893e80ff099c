import { digits, h } from "./dom.js";
import { Canvas, trace } from "./draw.js";
import { post } from "./net.js";
export class FirstFrame {
    wanted;
    element;
    node = h("canvas", { role: "img", "aria-label": "the film's first frame with the tags that were found" });
    words = h("figcaption", {});
    canvas;
    picture = new Image();
    frame = null;
    tags = [];
    asked = 0;
    strange = [];
    use = h("button", { type: "button", hidden: true, click: () => this.wanted(this.strange) }, "Use these tags");
    constructor(wanted) {
        this.wanted = wanted;
        this.element = h("figure", { class: "first" }, this.node, this.words, this.use);
        this.canvas = new Canvas(this.node, this.paint);
        this.picture.addEventListener("load", this.canvas.redraw);
        this.clear();
    }
    end() {
        this.canvas.end();
    }
    clear() {
        this.asked += 1;
        this.frame = null;
        this.node.hidden = this.use.hidden = true;
        this.words.textContent = "";
    }
    none() {
        this.clear();
        this.words.textContent = "This recording has no film.";
    }
    async load(name, file, topic, family) {
        const mine = ++this.asked;
        this.words.textContent = "Looking for tags in the first frame …";
        try {
            const frame = await post("/api/recordings/frame", { name, file, topic, family });
            if (mine !== this.asked)
                return;
            this.frame = frame;
            this.picture.src = frame.picture;
            this.node.style.aspectRatio = `${frame.width} / ${frame.height}`;
            this.node.hidden = false;
            this.say();
        }
        catch (error) {
            if (mine !== this.asked)
                return;
            this.clear();
            this.words.textContent = error.message;
        }
    }
    expect(tags) {
        this.tags = tags;
        this.say();
    }
    say() {
        if (!this.frame)
            return;
        const seen = this.frame.tags.map((one) => one.id), named = this.tags.map((one) => one.id), ids = (list) => [...new Set(list)].sort((a, b) => a - b).join(", ");
        const missing = named.filter((id) => !seen.includes(id)), strange = this.strange = [...new Set(seen.filter((id) => !named.includes(id)))].sort((a, b) => a - b);
        const parts = [seen.length ? `Tags in the first frame: ${ids(seen)}.` : "No tag in the first frame."];
        if (missing.length)
            parts.push(`Not found: ${ids(missing)}.`);
        if (strange.length)
            parts.push(`Not in recording.toml: ${ids(strange)}.`);
        this.words.textContent = parts.join(" ");
        this.words.classList.toggle("warning", missing.length > 0);
        this.use.hidden = !strange.length;
        this.canvas.redraw();
    }
    paint = ({ context, width }, tint) => {
        if (!this.frame || !this.picture.complete)
            return;
        const scale = width / this.frame.width;
        context.drawImage(this.picture, 0, 0, width, this.frame.height * scale);
        context.font = "600 12px system-ui, sans-serif";
        context.textAlign = "center";
        for (const { id, corners } of this.frame.tags) {
            const tag = this.tags.find((one) => one.id === id), points = corners.map(([x, y]) => [x * scale, y * scale]);
            const colour = !tag ? "#b3558b" : tag.base ? "#0072b2" : "#007a5a", words = !tag ? `${id}?` : tag.base ? `${id} base` : tag.s === null ? `${id}` : `${id} s=${digits(tag.s, 2)}`;
            for (const [wide, line] of [[5, "#fff"], [2.5, colour]]) {
                context.lineWidth = wide;
                context.strokeStyle = line;
                trace(context, points, true);
                context.stroke();
            }
            const x = points.reduce((sum, one) => sum + one[0], 0) / 4, low = Math.max(...points.map((one) => one[1]));
            context.lineWidth = 4;
            context.strokeStyle = "#fff";
            context.strokeText(words, x, low + 15);
            context.fillStyle = colour;
            context.fillText(words, x, low + 15);
        }
        context.strokeStyle = tint.line;
    };
}
