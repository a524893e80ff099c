// The address after #: `#bend?model=out%2Flinear-beam`. What a room remembers stands there.

const ends: (() => void)[] = [];
const kept: Record<string, string> = {};  // of each room, what stood in its address

export const roomIsNamed = (): boolean => location.hash.length > 1;
export const roomName = (): string => location.hash.slice(1).split("?")[0] || "bend";

export function params(): URLSearchParams {
  const own = location.hash.split("?")[1];
  return new URLSearchParams(own ?? kept[roomName()] ?? "");
}

// A room that was left while it waited for an answer keeps what it has, and leaves the address of another alone.
export function remember(room: string, values: Record<string, string>): void {
  const text = new URLSearchParams(Object.entries(values).filter(([, value]) => value !== "")).toString();
  kept[room] = text;
  if (roomName() === room) history.replaceState(null, "", `#${room}${text ? `?${text}` : ""}`);
}

// What a room does when it is left.
export function atEnd(...work: (() => void)[]): void {
  ends.push(...work);
}

export function leave(): void {
  for (const end of ends.splice(0)) end();
}
