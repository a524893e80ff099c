import { digits, h } from "./dom.js";
import { Canvas, HIGH, label, logTicks, ticks, trace, WIDE } from "./draw.js";
const LEFT = 52, RIGHT = 12, TOP = 12, BOTTOM = 24;
export class TimeChart {
    words;
    log;
    element;
    node;
    canvas;
    lines = [];
    levels = [];
    until = 1;
    now = 0;
    constructor(words, log, to) {
        this.words = words;
        this.log = log;
        this.node = h("canvas", { role: "img", "aria-label": words });
        this.element = h("figure", { class: "chart" }, this.node);
        this.canvas = new Canvas(this.node, this.paint);
        const point = (event) => {
            if (event.type === "pointermove" && event.buttons === 0)
                return;
            const box = this.node.getBoundingClientRect();
            to(Math.min(Math.max((event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT), 0), 1) * this.until);
        };
        this.node.addEventListener("pointerdown", point);
        this.node.addEventListener("pointermove", point);
    }
    end() {
        this.canvas.end();
    }
    set(lines, levels, until) {
        [this.lines, this.levels, this.until] = [lines, levels, until];
        this.canvas.redraw();
    }
    at(now) {
        this.now = now;
        this.canvas.redraw();
    }
    range() {
        const every = [...this.lines.flatMap((one) => one.values), ...this.levels.map((one) => one.value)].filter(Number.isFinite);
        if (!every.length)
            return this.log ? [0.01, 10] : [0, 1];
        const most = Math.max(...every, 1e-9);
        return this.log ? [Math.max(Math.min(...every.filter((one) => one > 0), 0.5 * most), 1e-4 * most, 0.005), 1.5 * most] : [0, 1.25 * most];
    }
    paint = ({ context, width, height }, tint) => {
        const [low, high] = this.range(), [right, bottom] = [width - RIGHT, height - BOTTOM], scale = (one) => this.log ? Math.log(Math.max(one, low)) : one;
        const x = (time) => LEFT + time / this.until * (right - LEFT);
        const y = (one) => bottom - (bottom - TOP) * (scale(one) - scale(low)) / (scale(high) - scale(low));
        context.strokeStyle = tint.line;
        context.fillStyle = tint.muted;
        context.lineWidth = 1;
        context.textAlign = "right";
        for (const mark of this.log ? logTicks(low, high) : ticks(low, high, bottom - TOP, HIGH)) {
            trace(context, [[LEFT, y(mark)], [right, y(mark)]]);
            context.stroke();
            context.fillText(digits(mark, 2).replace(/\.0$/, ""), LEFT - 7, y(mark) + 4);
        }
        context.textAlign = "center";
        for (const time of ticks(0, this.until, right - LEFT, WIDE)) {
            trace(context, [[x(time), TOP], [x(time), bottom]]);
            context.stroke();
            context.fillText(`${digits(time, 3).replace(/\.0+$/, "")} s`, Math.min(x(time), right - 10), bottom + 16);
        }
        for (const { value } of this.levels) {
            context.setLineDash([3, 4]);
            context.strokeStyle = tint.muted;
            trace(context, [[LEFT, y(value)], [right, y(value)]]);
            context.stroke();
            context.setLineDash([]);
        }
        for (const { time, values, tint: colour, thin } of this.lines) {
            context.strokeStyle = tint[colour];
            context.lineWidth = thin ? 1.2 : 2;
            trace(context, time.map((one, i) => [x(one), y(values[i])]));
            context.stroke();
        }
        context.textAlign = "left";
        for (const { value, words } of this.levels)
            label(context, words, LEFT + 6, y(value) + 13, tint.muted, tint.paper);
        context.textAlign = "right";
        label(context, this.words, right - 6, TOP + 12, tint.muted, tint.paper);
        if (!this.lines.length)
            return;
        context.strokeStyle = tint.ink;
        context.lineWidth = 1;
        trace(context, [[x(this.now), TOP], [x(this.now), bottom]]);
        context.stroke();
    };
}
