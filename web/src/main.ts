// Which room is shown: the address after # says it, so that a reload or a copied address comes back to it.
import { bend } from "./bend.js";
import { h } from "./dom.js";
import { learn } from "./learn.js";
import { connect, say } from "./net.js";
import { leave, params, roomName } from "./place.js";
import { record } from "./record.js";

const ROOMS = { record: ["Record", record], learn: ["Learn", learn], bend: ["Bend", bend] } as const;
type Room = keyof typeof ROOMS;

const place = document.getElementById("room")!, nav = document.querySelector("nav")!;
let shown: Room | null = null;

function show(): void {
  const name = roomName(), room: Room = name in ROOMS ? name as Room : "bend";
  for (const link of nav.querySelectorAll("a")) {
    if (link.dataset.room === room) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (shown === room) return;
  shown = room;
  leave();
  place.replaceChildren();
  place.className = room;
  document.title = `${ROOMS[room][0]} · onebend studio`;
  ROOMS[room][1](place, params());
}

for (const [room, [words]] of Object.entries(ROOMS)) nav.append(h("a", { href: `#${room}`, "data-room": room }, words));
window.addEventListener("hashchange", show);
window.addEventListener("unhandledrejection", (event) => {
  say(event.reason instanceof Error ? event.reason.message : String(event.reason));
});
connect((words) => { document.getElementById("link")!.textContent = words; });
show();
