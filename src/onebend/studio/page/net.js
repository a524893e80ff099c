const listeners = new Set();
const returns = new Set();
export const SILENT = "The studio does not answer.";
let socket = null, wait = 250, me = 0, gone = 0;
export function listen(listener) {
    listeners.add(listener);
    return () => { listeners.delete(listener); };
}
export function onReturn(work) {
    returns.add(work);
    if (isOpen())
        work();
    return () => { returns.delete(work); };
}
export const isOpen = () => socket !== null && socket.readyState === WebSocket.OPEN;
export const whoAmI = () => me;
export function send(message) {
    if (!isOpen())
        return false;
    socket.send(JSON.stringify(message));
    return true;
}
export function connect(status) {
    socket = new WebSocket(`ws://${location.host}/socket`);
    socket.addEventListener("message", (event) => {
        const message = JSON.parse(event.data);
        if (message.what === "hello")
            me = message.you;
        for (const listener of [...listeners])
            listener(message);
    });
    socket.addEventListener("open", () => {
        wait = 250;
        gone = 0;
        status("");
        for (const work of [...returns])
            work();
    });
    socket.addEventListener("close", () => {
        gone += 1;
        status(gone > 4 ? "The studio is not there. Start `onebend studio` again, and open its new address." : "reconnecting …");
        setTimeout(() => connect(status), wait);
        wait = Math.min(2 * wait, 4000);
    });
}
export async function ask(path, parameters = {}) {
    return answerOf(await reached(`${path}?${new URLSearchParams(parameters)}`));
}
export async function post(path, body) {
    const headers = { "Content-Type": "application/json" };
    return answerOf(await reached(path, { method: "POST", headers, body: JSON.stringify(body) }));
}
async function reached(path, how) {
    try {
        return await fetch(path, how);
    }
    catch {
        throw new Error(SILENT);
    }
}
async function answerOf(answer) {
    if (answer.ok)
        return await answer.json();
    const text = await answer.text();
    let words = text;
    try {
        words = JSON.parse(text).error;
    }
    catch { }
    throw new Error(words || `the studio answered ${answer.status}`);
}
let hiding = 0;
export function say(words) {
    const place = document.getElementById("said");
    place.textContent = words;
    clearTimeout(hiding);
    if (words)
        hiding = window.setTimeout(() => { place.textContent = ""; }, 9000);
}
