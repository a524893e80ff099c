const ends = [];
const kept = {};
export const roomIsNamed = () => location.hash.length > 1;
export const roomName = () => location.hash.slice(1).split("?")[0] || "bend";
export function params() {
    const own = location.hash.split("?")[1];
    return new URLSearchParams(own ?? kept[roomName()] ?? "");
}
export function remember(room, values) {
    const text = new URLSearchParams(Object.entries(values).filter(([, value]) => value !== "")).toString();
    kept[room] = text;
    if (roomName() === room)
        history.replaceState(null, "", `#${room}${text ? `?${text}` : ""}`);
}
export function atEnd(...work) {
    ends.push(...work);
}
export function leave() {
    for (const end of ends.splice(0))
        end();
}
