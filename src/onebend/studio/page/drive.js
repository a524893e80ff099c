import { coded, commandLine, digits, fixed, h } from "./dom.js";
import { Canvas } from "./draw.js";
import { LoopPlane } from "./looped.js";
import { ask, listen, onReturn, post, say } from "./net.js";
import { atEnd, remember } from "./place.js";
import { TimeChart } from "./timechart.js";
import { isBusy } from "./work.js";
const WORDS = { waiting: "films the rest, and nothing moves yet" };
const USUAL = { robot: "virtual:linear", camera: "", out: "driven", x: "", y: "", point: "1", push: "1" };
const LABELS = { robot: "robot", camera: "camera", out: "folder to record into", x: "goal, x in mm", y: "goal, y in mm", point: "point that is led, s", push: "place of the tool, s" };
const size = ([x, y]) => x === null || y === null ? NaN : Math.hypot(x, y);
export function drive(place, at) {
    place.classList.add("loop");
    const scene = { beam: null, map: null, goal: [0, 0], trials: [], now: 0, push: 1, point: 1, stale: false, focus: false, band: null };
    const plane = new LoopPlane(scene), element = h("canvas", { role: "img", "aria-label": "The beam, its goal and the force. A click moves the goal." }), canvas = new Canvas(element, plane.paint);
    const model = h("select", { "aria-label": "learned beam", change: () => { void open(null); } }), like = h("select", { "aria-label": "a recording of this beam on this bench", change: () => changed() });
    const fields = Object.fromEntries(Object.entries(USUAL).map(([key, usual]) => [key, h("input", { ...(key.length < 3 || key[0] === "p" ? { type: "number", step: "any" } : { type: "text" }), value: at.get(key) ?? usual, "aria-label": LABELS[key], input: () => changed() })]));
    const plan = h("button", { type: "button", class: "main", click: () => { void begin(); } }, "Plan"), go = h("button", { type: "button", class: "main", click: () => { say(""); void post("/api/work/drive/go", {}); } }, "Go");
    const stop = h("button", { type: "button", title: "holds, and releases slowly; a second time lets go at once", click: () => { void post("/api/work/drive/stop", {}); } }, "Stop");
    const status = h("p", { class: "status", role: "status" }), broken = h("p", { class: "warning", role: "alert", hidden: true }), rows = h("dl", { class: "words" }), known = h("dl", {}), command = commandLine();
    const error = new TimeChart("from the goal [mm]", true, () => undefined), force = new TimeChart("force on the beam [N]", false, () => undefined);
    let job = null, planned = null, outcome = null, live = null, felt = [], got = -1;
    const row = (words, input, unit = "") => h("div", {}, h("label", {}, h("span", {}, words), input, h("span", { class: "unit" }, unit)));
    place.append(h("section", { class: "stage" }, h("div", { class: "toolbar" }, plan, go, stop, status), broken, element, h("div", { class: "charts" }, error.element, force.element), h("section", { class: "outcome" }, rows, known), command.element), h("aside", { class: "panel" }, h("section", { class: "settings" }, h("h2", {}, "Beam"), row("learned", model), row("like", like), row("into", fields.out), h("h2", {}, "Goal"), row("x", fields.x, "mm"), row("y", fields.y, "mm"), row("point s", fields.point), row("tool at s", fields.push), h("h2", {}, "Bench"), row("robot", fields.robot), row("camera", fields.camera)), h("p", { class: "quiet" }, "Nothing moves before Go. A virtual robot has its own camera. Keep a hand on the emergency stop of a real one.")));
    function wanted() {
        const text = (key) => fields[key].value.trim(), metres = (key) => Number((fields[key].valueAsNumber / 1000).toFixed(6));
        return { model: model.value, like: like.value, robot: text("robot"), camera: text("camera"), out: text("out"), goal_m: [metres("x"), metres("y")], push_s: fields.push.valueAsNumber, point_s: fields.point.valueAsNumber };
    }
    function same() {
        const mine = wanted();
        return job !== null && Object.entries(mine).every(([key, value]) => JSON.stringify(value) === JSON.stringify(job[key]));
    }
    function changed() {
        const settings = wanted(), busy = isBusy(job), moving = busy && job.now !== null, whole = settings.goal_m.every(Number.isFinite) && settings.push_s > 0 && settings.point_s > 0;
        if (whole && !moving)
            scene.goal = settings.goal_m;
        plan.disabled = moving || !scene.beam || !settings.like || !whole || job?.state === "stopping";
        go.disabled = moving || job?.state !== "running" || !planned || !same();
        stop.disabled = !busy;
        scene.band = planned && same() ? planned.band_m : null;
        command.set(job && same() ? job.command : "");
        remember("drive", { model: model.value, like: like.value, ...Object.fromEntries(Object.entries(fields).map(([key, field]) => [key, field.value === USUAL[key] ? "" : field.value])) });
        canvas.redraw();
    }
    async function begin() {
        say("");
        if (isBusy(job))
            await post("/api/work/drive/stop", {});
        await post("/api/work/drive/start", wanted());
    }
    async function open(goal) {
        const name = model.value, beam = await ask("/api/beam", { name });
        if (name !== model.value)
            return;
        scene.beam = beam;
        const [x, y] = goal ?? beam.goal_m;
        if (!fields.x.value || !at.has("x"))
            [fields.x.value, fields.y.value] = [x, y].map((one) => String(Number((1000 * one).toFixed(2))));
        changed();
    }
    function adopt(now) {
        const mm = now.goal_m.map((one) => String(Number((1000 * one).toFixed(3))));
        for (const [key, value] of Object.entries({ model: now.model, like: now.like, x: mm[0], y: mm[1] }))
            at.set(key, value);
        const put = { x: mm[0], y: mm[1], robot: now.robot, camera: now.camera, out: now.out, point: String(now.point_s), push: String(now.push_s) };
        for (const [key, value] of Object.entries(put))
            fields[key].value = value;
    }
    async function fill() {
        const { found } = await ask("/api/places"), named = (kind) => found.filter((one) => one.kind === kind).map((one) => one.name);
        const state = await ask("/api/work/drive");
        if (state.job && !model.value && !at.has("x"))
            adopt(state.job);
        for (const [list, kind, key] of [[model, "result", "model"], [like, "recording", "like"]]) {
            const chosen = list.value || (at.get(key) ?? "");
            list.replaceChildren(...named(kind).map((name) => h("option", { value: name, selected: name === chosen }, name)));
        }
        if (!model.value)
            status.replaceChildren("No learned beam in this folder yet. ", h("a", { href: "#learn" }, "Learn a recording"), " first.");
        else if (scene.beam?.name !== model.value)
            await open(null);
        take(state.job, state.found);
    }
    function take(now, found) {
        if (now?.began !== job?.began)
            [planned, outcome, live, scene.trials, felt] = [null, null, null, [], []];
        job = now;
        if (found) {
            got = found.length;
            planned = found.find((one) => "plan" in one) ?? null;
            outcome = found.find((one) => "outcome" in one) ?? null;
        }
        if (now?.now)
            follow(now, now.now);
        rows.replaceChildren(...(planned?.plan ?? []).flatMap(([what, words]) => [h("dt", {}, what), h("dd", {}, words)]));
        const ended = outcome?.outcome.map((one) => `${one.reached ? "reached" : "not reached"}: seen ${fixed(1000 * (one.off_m ?? NaN), 2)} mm off, and ${digits(1000 * (one.said_within_m ?? NaN), 2)} mm were said. Recorded in ${outcome.folder}.`).join(" ");
        status.textContent = now ? ended || (now.now && (now.now.says || WORDS[now.now.stage])) || (now.stages.at(-1)?.stage ?? "") : "";
        broken.hidden = !now?.error;
        broken.replaceChildren(...coded(now?.error ?? ""));
        changed();
    }
    function follow(settings, now) {
        live ??= { name: "live", factor: 1, drawn: false, steady_m: null, settled_s: null, time_s: [], error_m: [], force_N: [], axis_m: [], point_m: [] };
        [scene.goal, scene.push, scene.point] = [now.goal_m, settings.push_s, settings.point_s];
        const shown = (pair, instead) => pair[0] === null || pair[1] === null ? instead : [pair[0], pair[1]];
        if (now.time_s > (live.time_s.at(-1) ?? -1)) {
            live.time_s.push(now.time_s);
            live.error_m.push(now.distance_m ?? NaN);
            live.force_N.push(shown(now.force_N, [0, 0]));
            felt.push(size(now.felt_N));
            live.axis_m.push(now.axis_m);
            live.point_m.push(shown(now.point_m, now.axis_m[Math.round(settings.point_s * (now.axis_m.length - 1))]));
        }
        scene.trials = [live];
        scene.now = now.time_s;
        const look = { time: live.time_s, tint: "blue", thin: false }, until = Math.max(now.time_s, 5);
        error.set([{ ...look, values: live.error_m.map((one) => 1000 * one) }], now.said_m === null ? [] : [{ value: 1000 * now.said_m, words: "within which it is said to rest (95 %)" }], until);
        force.set([{ ...look, values: live.force_N.map(([x, y]) => Math.hypot(x, y)) }, { ...look, tint: "orange", thin: true, values: felt }], [], until);
        for (const chart of [error, force])
            chart.at(now.time_s);
        const facts = [["stage", now.stage], ["from the goal", `${fixed(1000 * (now.distance_m ?? NaN), 2)} mm`], ["force (blue)", `${digits(size(now.force_N))} N`],
            ["force felt (orange)", `${digits(size(now.felt_N))} N`], ["delay, measured", `${fixed(1000 * (now.delay_s ?? NaN), 0)} ms`]];
        known.replaceChildren(...facts.map(([what, words]) => h("div", { class: "row" }, h("dt", {}, what), h("dd", {}, words))));
    }
    async function hear(message) {
        if (message.what === "places")
            await fill();
        if (message.what !== "work" || message.room !== "drive")
            return;
        const now = message.job;
        const found = now.began === job?.began && now.found === got ? null : (await ask("/api/work/drive")).found;
        take(now, found);
    }
    const drag = (event) => {
        if (!scene.beam || isBusy(job) && job.now || event.type === "pointermove" && !element.hasPointerCapture(event.pointerId))
            return;
        const box = element.getBoundingClientRect(), goal = plane.metres([event.clientX - box.left, event.clientY - box.top]);
        [fields.x.value, fields.y.value] = goal.map((one) => String(Number((1000 * one).toFixed(2))));
        changed();
    };
    element.addEventListener("pointerdown", (event) => { if (event.button === 0) {
        element.setPointerCapture(event.pointerId);
        drag(event);
    } });
    element.addEventListener("pointermove", drag);
    atEnd(listen((message) => { void hear(message); }), onReturn(() => { void fill(); }), () => { canvas.end(); error.end(); force.end(); });
}
