// Which room is shown: the address after # says it, so that a reload or a copied address comes back to it.
import { bend } from "./bend.js";
import { h } from "./dom.js";
import { ask, connect, onReturn, say, SILENT } from "./net.js";
import { leave, params, roomIsNamed, roomName } from "./place.js";

// What the first picture does not need is loaded with its room.
const ROOMS = {
  record: ["Record", async () => (await import("./record.js")).record],
  recordings: ["Recordings", async () => (await import("./recordings.js")).recordings],
  learn: ["Learn", async () => (await import("./learn.js")).learn],
  bend: ["Bend", async () => bend],
  loop: ["Loop", async () => (await import("./loop.js")).loop],
  drive: ["Drive", async () => (await import("./drive.js")).drive],
} as const;
type Room = keyof typeof ROOMS;

const place = document.getElementById("room")!, nav = document.querySelector("nav")!;
let shown: Room | null = null, turn = 0, missed = false;

async function show(): Promise<void> {
  const name = roomName(), room: Room = name in ROOMS ? name as Room : "bend";
  for (const link of nav.querySelectorAll("a")) {
    if (link.dataset.room === room) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
  }
  if (shown === room && !location.hash.includes("?")) return;  // its own link; an address that says more is gone to
  shown = room;
  leave();
  place.replaceChildren();
  place.className = room;
  document.title = `${ROOMS[room][0]} · onebend studio`;
  const mine = ++turn, begin = await ROOMS[room][1]().catch(() => null);  // nothing where the studio does not answer
  if (mine !== turn) return;  // another may have been chosen meanwhile
  missed = begin === null;
  if (begin) begin(place, params());
  else place.replaceChildren(h("p", { class: "warning away", role: "alert" }, `${SILENT} The room ${ROOMS[room][0]} opens when it is back.`));
}

for (const [room, [words]] of Object.entries(ROOMS)) nav.append(h("a", { href: `#${room}`, "data-room": room }, words));
window.addEventListener("hashchange", () => { void show(); });
window.addEventListener("unhandledrejection", (event) => {
  say(event.reason instanceof Error ? event.reason.message : String(event.reason));
});
onReturn(() => { if (missed) location.reload(); });  // a browser keeps a failed load of a module
connect((words) => { document.getElementById("link")!.textContent = words; });

// Where no beam was learned yet, the first thing to do is a recording.
async function begin(): Promise<void> {
  if (!roomIsNamed()) {
    const { found } = await ask<{ found: { kind: string }[] }>("/api/places").catch(() => ({ found: [{ kind: "result" }] }));
    if (!roomIsNamed() && !found.some((one) => one.kind === "result")) history.replaceState(null, "", "#recordings");
  }
  await show();
}
void begin();
