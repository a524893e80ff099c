import { bend } from "./bend.js";
import { h } from "./dom.js";
import { learn } from "./learn.js";
import { connect, say } from "./net.js";
import { leave, params, roomName } from "./place.js";
import { record } from "./record.js";
const ROOMS = { record: ["Record", record], learn: ["Learn", learn], bend: ["Bend", bend] };
const place = document.getElementById("room"), nav = document.querySelector("nav");
let shown = null;
function show() {
    const name = roomName(), room = name in ROOMS ? name : "bend";
    for (const link of nav.querySelectorAll("a")) {
        if (link.dataset.room === room)
            link.setAttribute("aria-current", "page");
        else
            link.removeAttribute("aria-current");
    }
    if (shown === room)
        return;
    shown = room;
    leave();
    place.replaceChildren();
    place.className = room;
    document.title = `${ROOMS[room][0]} · onebend studio`;
    ROOMS[room][1](place, params());
}
for (const [room, [words]] of Object.entries(ROOMS))
    nav.append(h("a", { href: `#${room}`, "data-room": room }, words));
window.addEventListener("hashchange", show);
window.addEventListener("unhandledrejection", (event) => {
    say(event.reason instanceof Error ? event.reason.message : String(event.reason));
});
connect((words) => { document.getElementById("link").textContent = words; });
show();
