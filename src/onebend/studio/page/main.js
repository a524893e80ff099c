import { bend } from "./bend.js";
import { h } from "./dom.js";
import { ask, connect, onReturn, say, SILENT } from "./net.js";
import { leave, params, roomIsNamed, roomName } from "./place.js";
const ROOMS = {
    record: ["Record", async () => (await import("./record.js")).record],
    recordings: ["Recordings", async () => (await import("./recordings.js")).recordings],
    learn: ["Learn", async () => (await import("./learn.js")).learn],
    bend: ["Bend", async () => bend],
    loop: ["Loop", async () => (await import("./loop.js")).loop],
    drive: ["Drive", async () => (await import("./drive.js")).drive],
};
const place = document.getElementById("room"), nav = document.querySelector("nav");
let shown = null, turn = 0, missed = false;
async function show() {
    const name = roomName(), room = name in ROOMS ? name : "bend";
    for (const link of nav.querySelectorAll("a")) {
        if (link.dataset.room === room)
            link.setAttribute("aria-current", "page");
        else
            link.removeAttribute("aria-current");
    }
    if (shown === room && !location.hash.includes("?"))
        return;
    shown = room;
    leave();
    place.replaceChildren();
    place.className = room;
    document.title = `${ROOMS[room][0]} · onebend studio`;
    const mine = ++turn, begin = await ROOMS[room][1]().catch(() => null);
    if (mine !== turn)
        return;
    missed = begin === null;
    if (begin)
        begin(place, params());
    else
        place.replaceChildren(h("p", { class: "warning away", role: "alert" }, `${SILENT} The room ${ROOMS[room][0]} opens when it is back.`));
}
for (const [room, [words]] of Object.entries(ROOMS))
    nav.append(h("a", { href: `#${room}`, "data-room": room }, words));
window.addEventListener("hashchange", () => { void show(); });
window.addEventListener("unhandledrejection", (event) => {
    say(event.reason instanceof Error ? event.reason.message : String(event.reason));
});
onReturn(() => { if (missed)
    location.reload(); });
connect((words) => { document.getElementById("link").textContent = words; });
async function begin() {
    if (!roomIsNamed()) {
        const { found } = await ask("/api/places").catch(() => ({ found: [{ kind: "result" }] }));
        if (!roomIsNamed() && !found.some((one) => one.kind === "result"))
            history.replaceState(null, "", "#recordings");
    }
    await show();
}
void begin();
