import { coded, h } from "./dom.js";
import { post } from "./net.js";
export const isBusy = (job) => job?.state === "running" || job?.state === "stopping";
export function progressOf(job, title, room) {
    const busy = isBusy(job), stages = job.stages.length ? job.stages : [{ stage: "starting", done: 0, total: null }];
    const ended = { stopped: "Stopped", failed: "It could not be done" }[job.state];
    return h("section", { class: "job", "aria-label": title }, h("h2", {}, ended ?? title), busy && h("ol", {}, ...stages.map((one, i) => h("li", { class: i === stages.length - 1 ? "busy" : "" }, h("span", {}, one.stage), h("span", { class: "quiet" }, one.total ? `${one.done} of ${one.total}` : ""), h("progress", one.total ? { value: one.done, max: one.total, "aria-label": one.stage } : { "aria-label": one.stage })))), job.state === "failed" && h("p", { class: "warning error" }, ...coded(job.error)), busy && h("button", { type: "button", disabled: job.state === "stopping", click: () => { void post(`/api/work/${room}/stop`, {}); } }, job.state === "stopping" ? "stopping …" : "Stop"));
}
