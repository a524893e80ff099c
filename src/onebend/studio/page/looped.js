import { arrow, HIGH, label, ticks, trace, WIDE } from "./draw.js";
import { drawReach } from "./reach.js";
const ARROW = 0.28;
export function tintOfTrial(trial) {
    return trial.drawn ? "orange" : trial.factor < 1 ? "orange" : trial.factor > 1 ? "green" : "blue";
}
export function momentOf(time, now) {
    let low = 0, high = time.length - 1;
    while (high - low > 1) {
        const middle = (low + high) >> 1;
        if (time[middle] <= now)
            low = middle;
        else
            high = middle;
    }
    return [low, Math.min(Math.max((now - time[low]) / Math.max(time[high] - time[low], 1e-9), 0), 1)];
}
const between = (a, b, part) => [a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1])];
function along(line, s) {
    const place = s * (line.length - 1), low = Math.min(Math.floor(place), line.length - 2);
    return between(line[low], line[low + 1], place - low);
}
export class LoopPlane {
    scene;
    scale = 1;
    origin = [0, 0];
    constructor(scene) {
        this.scene = scene;
    }
    px = ([x, y]) => [this.origin[0] + this.scale * x, this.origin[1] - this.scale * y];
    metres([x, y]) {
        return [(x - this.origin[0]) / this.scale, (this.origin[1] - y) / this.scale];
    }
    fit({ width, height }) {
        const { beam, goal, trials } = this.scene, room = beam.length_m;
        const points = [...beam.rest_m, goal, [0, -0.45 * room], [0, 0.68 * room], ...trials.flatMap((one) => one.point_m ?? [])];
        const [xs, ys] = [points.map((one) => one[0]), points.map((one) => one[1])];
        const [left, right, low, high] = [Math.min(...xs) - 0.06 * room, Math.max(...xs) + 0.12 * room, Math.min(...ys) - 0.1 * room, Math.max(...ys) + 0.1 * room];
        this.scale = Math.min(width / (right - left), (height - 20) / (high - low));
        this.origin = [0.5 * width - this.scale * 0.5 * (left + right), 0.5 * (height - 20) + this.scale * 0.5 * (low + high)];
    }
    paint = (canvas, tint) => {
        const { beam, trials, stale } = this.scene, { context } = canvas;
        if (!beam)
            return;
        this.fit(canvas);
        this.grid(canvas, tint);
        if (this.scene.map)
            drawReach(context, tint, this.px, this.scene.map);
        this.clamp(context, tint);
        this.line(context, beam.rest_m, tint.line, 4);
        const most = Math.max(...trials.flatMap((one) => (one.force_N ?? []).map(([x, y]) => Math.hypot(x, y))), 1e-12);
        context.globalAlpha = stale ? 0.35 : 1;
        trials.map((trial, i) => [trial, i]).reverse().forEach(([trial, i]) => this.trial(context, tint, trial, most, i));
        context.globalAlpha = 1;
        if (this.scene.band) {
            context.strokeStyle = tint.pink;
            context.lineWidth = 1;
            trace(context, this.scene.band.map(this.px));
            context.stroke();
        }
        this.goal(context, tint);
        if (this.scene.focus) {
            context.strokeStyle = tint.blue;
            context.lineWidth = 2;
            context.strokeRect(2, 2, canvas.width - 4, canvas.height - 4);
        }
    };
    trial(context, tint, trial, most, order) {
        if (!trial.time_s)
            return;
        const [i, part] = momentOf(trial.time_s, this.scene.now), next = Math.min(i + 1, trial.time_s.length - 1), colour = tint[tintOfTrial(trial)];
        const line = trial.axis_m[i].map((one, k) => between(one, trial.axis_m[next][k], part));
        context.strokeStyle = colour;
        context.lineWidth = 1;
        const before = context.globalAlpha;
        context.globalAlpha = 0.5 * before;
        trace(context, [...trial.point_m.slice(0, i + 1), between(trial.point_m[i], trial.point_m[next], part)].map(this.px));
        context.stroke();
        context.globalAlpha = before;
        this.line(context, line, colour, trial.drawn ? 1.8 : 3 + 3 * order);
        const force = between(trial.force_N[i], trial.force_N[next], part), size = ARROW * this.scene.beam.length_m / most;
        const from = along(line, this.scene.push), to = [from[0] + size * force[0], from[1] + size * force[1]];
        arrow(context, this.px(from), this.px(to), colour, trial.drawn ? 1.5 : 2.2);
        const [x, y] = this.px(between(trial.point_m[i], trial.point_m[next], part));
        context.fillStyle = colour;
        context.beginPath();
        context.arc(x, y, trial.drawn ? 3 : 4 + 1.5 * order, 0, 2 * Math.PI);
        context.fill();
    }
    line(context, points, colour, wide) {
        context.strokeStyle = colour;
        context.lineWidth = wide;
        trace(context, points.map(this.px));
        context.stroke();
    }
    clamp(context, tint) {
        const [x, y] = this.px([0, 0]);
        context.fillStyle = tint.muted;
        context.fillRect(x - 7, y - 18, 7, 36);
    }
    goal(context, tint) {
        const [x, y] = this.px(this.scene.goal);
        context.strokeStyle = tint.pink;
        context.lineWidth = 2.2;
        for (const [from, to] of [[[x - 15, y], [x - 5, y]], [[x + 5, y], [x + 15, y]], [[x, y - 15], [x, y - 5]], [[x, y + 5], [x, y + 15]]]) {
            trace(context, [from, to]);
            context.stroke();
        }
        context.beginPath();
        context.arc(x, y, 9, 0, 2 * Math.PI);
        context.stroke();
        context.textAlign = "left";
        label(context, "goal", x + 14, y - 10, tint.pink, tint.paper);
    }
    grid({ context, width, height }, tint) {
        const [left, high] = this.metres([0, 0]), [right, low] = this.metres([width, height]);
        context.strokeStyle = tint.line;
        context.fillStyle = tint.muted;
        context.lineWidth = 1;
        context.textAlign = "center";
        const marks = ticks(1000 * left, 1000 * right, width, WIDE);
        for (const mark of marks) {
            const [x] = this.px([mark / 1000, 0]);
            trace(context, [[x, 0], [x, height - 20]]);
            context.stroke();
            if (x > 14 && x < width - 46)
                context.fillText(String(mark), x, height - 5);
        }
        context.textAlign = "right";
        context.fillText("mm", width - 4, height - 5);
        for (const mark of ticks(1000 * low, 1000 * high, height, HIGH)) {
            const [, y] = this.px([0, mark / 1000]);
            trace(context, [[0, y], [width, y]]);
            context.stroke();
            if (y > 12 && y < height - 26)
                label(context, String(mark), width - 6, y + 4, tint.muted, tint.paper);
        }
    }
}
