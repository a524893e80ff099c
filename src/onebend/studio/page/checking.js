import { coded, h } from "./dom.js";
import { ask, post } from "./net.js";
import { progressOf } from "./work.js";
export class Checking {
    element;
    start = h("button", { type: "button", click: () => { void this.begin(); } }, "Check the recording");
    note = h("span", { class: "quiet" });
    progress = h("div");
    found = h("div", { class: "findings" });
    name = "";
    shown = "";
    constructor(command) {
        this.element = h("section", { class: "check-room" }, h("h2", {}, "Check"), h("p", { class: "links" }, this.start, this.note), command, this.progress, this.found);
    }
    of(name) {
        this.name = name;
        this.shown = "";
        this.found.replaceChildren();
        void this.look();
    }
    dirty(dirty) {
        this.note.textContent = dirty ? "of the file as it is saved" : "reads all files, looks for the tags in some twenty frames";
    }
    async look() {
        const { job, found } = await ask("/api/work/check");
        this.take(job);
        if (found[0] && found[0].name === this.name)
            this.show(found[0], job);
    }
    hear(job) {
        this.take(job);
        if (job && job.name === this.name && job.found > 0 && this.shown !== String(job.began))
            void this.look();
    }
    take(job) {
        const busy = job?.state === "running" || job?.state === "stopping", mine = job?.name === this.name;
        this.start.disabled = busy;
        this.progress.replaceChildren(...(job && (busy || mine) && job.state !== "done" ? [progressOf(job, `Checking ${job.name}`, "check")] : []));
        if (busy && mine && !job.found)
            this.found.replaceChildren();
    }
    async begin() {
        this.shown = "";
        await post("/api/work/check/start", { name: this.name });
    }
    show(found, job) {
        if (this.shown === String(job.began))
            return;
        this.shown = String(job.began);
        this.found.replaceChildren(...(found.faults.length ? [h("ul", { class: "remarks faults" }, ...found.faults.map((one) => h("li", { class: "warning" }, ...coded(one))))]
            : [h("p", { class: "good" }, "Nothing was found that would stop it from being learned.")]), h("dl", { class: "words" }, ...Object.entries(found.understood).flatMap(([what, words]) => [h("dt", {}, what), h("dd", {}, words)])), ...(found.remarks.length ? [h("ul", { class: "remarks" }, ...found.remarks.map((one) => h("li", { class: one.level === "warning" ? "warning" : "quiet" }, ...coded(one.text))))] : []), ...(found.unwritten ? [h("p", { class: "warning" }, `The picture could not be kept: ${found.unwritten}`)] : []), ...(found.picture ? [h("img", { class: "paper", alt: `the picture of the check of ${found.name}`, src: `/api/check.png?${new URLSearchParams({ name: found.name, at: String(job.began) })}` })] : []), h("p", {}, h("a", { href: `#learn?from=${encodeURIComponent(found.name)}` }, "Learn it")));
    }
}
