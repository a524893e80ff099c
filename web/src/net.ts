// The studio's socket, which comes back when it drops, and what is asked by HTTP.

export type Message = Record<string, any> & { what: string };
type Listener = (message: Message) => void;

const listeners = new Set<Listener>();
const returns = new Set<() => void>();
export const SILENT = "The studio does not answer.";
let socket: WebSocket | null = null, wait = 250, me = 0, gone = 0;

export function listen(listener: Listener): () => void {
  listeners.add(listener);
  return () => { listeners.delete(listener); };
}

// Called whenever the socket is there again: what is shown is asked for anew.
export function onReturn(work: () => void): () => void {
  returns.add(work);
  if (isOpen()) work();
  return () => { returns.delete(work); };
}

export const isOpen = (): boolean => socket !== null && socket.readyState === WebSocket.OPEN;
export const whoAmI = (): number => me;

export function send(message: Record<string, unknown>): boolean {
  if (!isOpen()) return false;
  socket!.send(JSON.stringify(message));
  return true;
}

export function connect(status: (words: string) => void): void {
  socket = new WebSocket(`ws://${location.host}/socket`);
  socket.addEventListener("message", (event) => {
    const message = JSON.parse(event.data as string) as Message;
    if (message.what === "hello") me = message.you as number;
    for (const listener of [...listeners]) listener(message);
  });
  socket.addEventListener("open", () => {
    wait = 250;
    gone = 0;
    status("");
    for (const work of [...returns]) work();
  });
  socket.addEventListener("close", () => {
    gone += 1;
    status(gone > 4 ? "The studio is not there. Start `onebend studio` again, and open its new address." : "reconnecting …");
    setTimeout(() => connect(status), wait);
    wait = Math.min(2 * wait, 4000);
  });
}

export async function ask<T>(path: string, parameters: Record<string, string> = {}): Promise<T> {
  return answerOf(await reached(`${path}?${new URLSearchParams(parameters)}`));
}

export async function post<T>(path: string, body: unknown): Promise<T> {
  const headers = { "Content-Type": "application/json" };
  return answerOf(await reached(path, { method: "POST", headers, body: JSON.stringify(body) }));
}

async function reached(path: string, how?: RequestInit): Promise<Response> {
  try {
    return await fetch(path, how);
  } catch {  // a browser only says that it failed
    throw new Error(SILENT);
  }
}

async function answerOf<T>(answer: Response): Promise<T> {
  if (answer.ok) return await answer.json() as T;
  const text = await answer.text();
  let words = text;
  try {
    words = (JSON.parse(text) as { error: string }).error;
  } catch { /* no JSON: as it is */ }
  throw new Error(words || `the studio answered ${answer.status}`);
}

let hiding = 0;
export function say(words: string): void {
  const place = document.getElementById("said")!;
  place.textContent = words;
  clearTimeout(hiding);
  if (words) hiding = window.setTimeout(() => { place.textContent = ""; }, 9000);
}
