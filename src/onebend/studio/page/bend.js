import { coded, commandLine, h } from "./dom.js";
import { Canvas } from "./draw.js";
import { ask, listen, onReturn, say, send, whoAmI } from "./net.js";
import { atEnd, remember } from "./place.js";
import { Panel } from "./panel.js";
import { Plane } from "./plane.js";
const NEAR = 26;
const GRADES = { "not to be trusted": "bad" };
export function bend(place, at) {
    const scene = { opened: null, answer: null, map: null, edge: null, goal: null, held: false, focus: false };
    const plane = new Plane(scene), element = h("canvas", {
        tabindex: 0, role: "application", "aria-describedby": "bend-readout",
        "aria-label": "The beam in its plane. Arrow keys move the point, with Shift further, with Alt less; Q and E turn the hand; Escape lets go.",
    });
    const canvas = new Canvas(element, plane.paint), command = commandLine(), panel = new Panel(change);
    const choice = h("select", { "aria-label": "learned beam", change: () => open(choice.value) });
    const broken = h("p", { class: "warning", role: "alert", hidden: true });
    let model = at.get("model") ?? "", grab = null, number = 0, wanted = null, waiting = 0;
    const asked = new Map();
    place.append(h("section", { class: "stage" }, h("div", { class: "toolbar" }, choice, panel.modes, panel.status), broken, element, command.element), panel.element);
    command.set("");
    function open(name) {
        model = name;
        broken.hidden = true;
        command.set("");
        panel.clear();
        Object.assign(scene, { opened: null, answer: null, map: null, edge: null, goal: null });
        remember("bend", { model });
        send({ do: "open", model });
        canvas.redraw();
    }
    function change(settings) {
        scene.goal = null;
        send({ do: "set", model, settings });
    }
    function move(goal, angle) {
        scene.goal = goal;
        wanted = angle === undefined ? goal : [...goal, angle];
        if (!waiting)
            waiting = requestAnimationFrame(flush);
        canvas.redraw();
    }
    function flush() {
        waiting = 0;
        for (const [n, began] of asked)
            if (performance.now() - began > 1000)
                asked.delete(n);
        if (!wanted || asked.size > 2)
            return;
        number += 1;
        asked.set(number, performance.now());
        if (!send({ do: "drag", model, n: number, goal: wanted }))
            asked.clear();
        wanted = null;
    }
    function hear(message) {
        if (message.what === "places")
            void fill(false);
        if (message.what === "error") {
            if (scene.opened)
                say(message.text);
            broken.hidden = scene.opened !== null;
            broken.replaceChildren(...coded(message.text));
        }
        if (message.model !== model)
            return;
        if (message.what === "forgotten" && !document.hidden)
            open(model);
        if (message.what === "beam") {
            const opened = message.opened;
            if (opened.version !== scene.opened?.version)
                scene.map = null;
            scene.opened = opened;
            broken.hidden = true;
            take(message.answer);
            panel.opened(opened);
        }
        else if (message.what === "answer") {
            const mine = message.by === whoAmI(), began = asked.get(message.n);
            if (mine)
                for (const n of [...asked.keys()])
                    if (n <= message.n)
                        asked.delete(n);
            if (!mine)
                scene.goal = message.answer.goal_m;
            take(message.answer);
            if (mine && began !== undefined)
                requestAnimationFrame(() => performance.measure("drag", { start: began, end: performance.now() }));
            if (wanted && !waiting)
                waiting = requestAnimationFrame(flush);
        }
        else if (message.what === "map") {
            scene.map = message.map;
            panel.mapped();
        }
        else if (message.what === "edge") {
            scene.edge = message.edge;
        }
        else if (message.what === "ellipse" && scene.answer) {
            scene.answer.ellipse = message.ellipse;
            panel.answer(scene.opened, scene.answer);
        }
        canvas.redraw();
    }
    function take(answer) {
        scene.answer = answer;
        command.set(answer.command);
        if (scene.opened)
            panel.answer(scene.opened, answer);
    }
    async function fill(first) {
        const { found } = await ask("/api/places");
        const results = found.filter((one) => one.kind === "result");
        choice.replaceChildren(...results.map((one) => h("option", { value: one.name, selected: one.name === model }, one.name)));
        choice.hidden = !results.length;
        if (!results.some((one) => one.name === model))
            model = results.sort((a, b) => b.changed - a.changed)[0]?.name ?? "";
        if (!model) {
            panel.empty();
            return;
        }
        choice.value = model;
        const grade = results.find((one) => one.name === model)?.grade ?? "";
        choice.className = GRADES[grade] ?? "";
        if (first || !scene.opened)
            open(model);
    }
    function where(event) {
        const box = element.getBoundingClientRect();
        return [event.clientX - box.left, event.clientY - box.top];
    }
    function apart(a, b) {
        return Math.hypot(a[0] - b[0], a[1] - b[1]);
    }
    element.addEventListener("pointerdown", (event) => {
        const { opened, answer } = scene;
        if (!opened || !answer || event.button !== 0)
            return;
        element.setPointerCapture(event.pointerId);
        const pointer = where(event), knob = plane.knob();
        const handle = plane.px([answer.pose[0], answer.pose[1]]);
        grab = knob && apart(pointer, knob) < NEAR ? "turn" : "point";
        scene.held = true;
        if (opened.mode === "point" && apart(pointer, handle) > NEAR) {
            const away = answer.line_m.map((one) => apart(plane.px(one), pointer)), near = Math.min(...away);
            const s = Math.max(0.1, Math.round(100 * away.indexOf(near) / (away.length - 1)) / 100);
            if (near < 14 && Math.abs(s - opened.point_s) > 0.03)
                change({ point_s: s, push_s: panel.linked ? s : opened.push_s });
        }
        drag(event);
        event.preventDefault();
        element.focus({ preventScroll: true });
    });
    element.addEventListener("pointermove", drag);
    for (const name of ["pointerup", "pointercancel"]) {
        element.addEventListener(name, () => {
            grab = null;
            scene.held = false;
            canvas.redraw();
        });
    }
    function drag(event) {
        if (!grab || !scene.answer)
            return;
        const pointer = where(event), [x, y] = scene.answer.pose;
        if (grab === "point") {
            move(plane.metres(pointer));
            return;
        }
        const end = plane.px([x, y]);
        move(scene.goal ?? [x, y], near(Math.atan2(end[1] - pointer[1], pointer[0] - end[0]), scene.answer.pose[2]));
    }
    element.addEventListener("keydown", (event) => {
        const { opened, answer } = scene;
        if (!opened || !answer || event.ctrlKey || event.metaKey)
            return;
        const step = opened.length_m * (event.shiftKey ? 0.05 : event.altKey ? 0.001 : 0.01);
        const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
        const way = ways[event.key], [x, y, angle] = answer.pose;
        const from = answer.limit ? [x, y] : scene.goal ?? [x, y];
        if (way)
            move([from[0] + step * way[0], from[1] + step * way[1]]);
        else if (/^[qe]$/i.test(event.key) && opened.mode === "hand")
            move(from, angle + (event.key.toLowerCase() === "q" ? 1 : -1) * (event.shiftKey ? 0.1 : 0.02));
        else if (event.key === "Escape")
            change({ rest: true });
        else if (event.key.toLowerCase() === "h")
            change({ mode: opened.mode === "hand" ? "point" : "hand" });
        else
            return;
        event.preventDefault();
    });
    element.addEventListener("focus", () => { scene.focus = element.matches(":focus-visible"); canvas.redraw(); });
    element.addEventListener("blur", () => { scene.focus = false; canvas.redraw(); });
    const back = () => { if (!document.hidden)
        send({ do: "open", model }); };
    document.addEventListener("visibilitychange", back);
    atEnd(() => document.removeEventListener("visibilitychange", back), listen(hear), onReturn(() => { asked.clear(); void fill(true); }), () => canvas.end());
}
function near(angle, other) {
    return angle + 2 * Math.PI * Math.round((other - angle) / (2 * Math.PI));
}
