import { coded, commandLine, h } from "./dom.js";
import { Editor } from "./editor.js";
import { FirstFrame } from "./firstframe.js";
import { ask, listen, onReturn, post, say } from "./net.js";
import { atEnd, remember } from "./place.js";
import { Checking } from "./checking.js";
const PAUSE = 40;
export function recordings(place, at) {
    const list = h("ul", { class: "names" }), films = h("ul", { class: "names" }), unwritten = h("section", { hidden: true }, h("h2", {}, "Without recording.toml"), films);
    const title = h("h1", { tabindex: -1 }), state = h("p", { class: "state", role: "status" }), told = h("div", { class: "told" });
    const keep = h("button", { type: "button", class: "main", disabled: true, "aria-keyshortcuts": "Control+S", click: () => { void save(version); } }, "Save");
    const back = h("button", { type: "button", hidden: true, click: () => take(disk, version) }, "back to the file");
    const theirs = h("pre"), conflict = h("section", { class: "conflict", role: "alert", hidden: true }, h("p", {}, h("b", {}, "recording.toml changed on disk"), " since it was opened here. Nothing was overwritten."), h("details", {}, h("summary", {}, "the file as it is now"), theirs), h("p", { class: "links" }, h("button", { type: "button", click: () => take(disk, seen) }, "take the file's text"), h("button", { type: "button", click: () => { void save(seen); } }, "put mine in its place")));
    const editor = new Editor(edited), frame = new FirstFrame((ids) => use(ids)), command = commandLine(), checking = new Checking(command.element);
    const desk = h("section", { class: "desk", hidden: true }, h("div", { class: "toolbar" }, title, state, back, keep), conflict, h("div", { class: "pair" }, editor.element, told, frame.element), checking.element);
    const nothing = h("p", { class: "empty quiet" }, "Choose a recording.");
    let name = at.get("name") ?? "", disk = "", version = "", seen = "", number = 0, waiting = 0, film = "", gone = false, unchecked = "";
    place.append(h("aside", { class: "side" }, h("section", {}, h("h2", {}, "Recordings"), list), unwritten), h("div", { class: "work" }, nothing, desk));
    const dirty = () => editor.text !== disk;
    async function fill() {
        const { found } = await ask("/api/places");
        const known = found.filter((one) => one.kind === "recording"), bare = found.filter((one) => one.kind === "film");
        list.replaceChildren(...known.map((one) => h("li", {}, h("button", { type: "button", class: "pick", "aria-current": one.name === name ? "true" : null,
            click: () => { void open(one.name); } }, one.name))));
        if (!known.length)
            list.append(h("li", { class: "quiet" }, "No folder with a recording.toml here."));
        unwritten.hidden = !bare.length;
        films.replaceChildren(...bare.map((one) => h("li", {}, h("span", {}, one.name), h("button", { type: "button", title: `onebend new ${one.name}`,
            "aria-label": `write a recording.toml to fill in into ${one.name}`, click: () => { void begin(one.name); } }, "begin"))));
        const there = known.some((one) => one.name === name);
        if (!desk.hidden) {
            if (gone === !there)
                return;
            gone = !there;
            edited();
            if (there)
                await look();
            return;
        }
        if (!there)
            name = at.has("name") ? "" : known[0]?.name ?? "";
        if (name)
            await open(name);
        else if (known.length)
            nothing.textContent = "Choose a recording.";
        else
            nothing.replaceChildren("Nothing is recorded in this folder yet. ", h("a", { href: "#record" }, "Record a push"), bare.length ? ", or begin the recording.toml of a film that is here." : ", or put a film and its force log into a folder here.");
    }
    async function begin(folder) {
        await post("/api/recordings/new", { name: folder });
        await open(folder);
        await fill();
    }
    async function open(wanted) {
        if (!desk.hidden && dirty())
            keepDraft();
        let found;
        try {
            found = await post("/api/recordings/read", { name: wanted });
        }
        catch (error) {
            if (desk.hidden || wanted !== name)
                unreadable(wanted, error.message);
            else
                say(error.message);
            return;
        }
        const draft = draftOf(wanted);
        name = wanted;
        [film, gone, unchecked] = ["", false, ""];
        remember("recordings", { name });
        title.textContent = name;
        desk.hidden = false;
        nothing.hidden = true;
        command.set(found.command);
        checking.of(name);
        frame.clear();
        conflict.hidden = true;
        current();
        take(found.text, found.version);
        show(found);
        if (draft && draft.text !== found.text) {
            editor.text = draft.text;
            version = draft.version;
            if (draft.version !== found.version)
                changedOnDisk(found.text, found.version);
            edited();
        }
    }
    function current() {
        for (const button of list.querySelectorAll("button"))
            button.toggleAttribute("aria-current", button.textContent === name);
    }
    function unreadable(wanted, words) {
        name = wanted;
        number += 1;
        clearTimeout(waiting);
        remember("recordings", { name });
        desk.hidden = true;
        nothing.hidden = false;
        nothing.classList.add("warning");
        nothing.textContent = `${wanted} cannot be opened here. ${words}`;
        current();
    }
    function take(text, at) {
        editor.text = disk = text;
        version = seen = at;
        conflict.hidden = true;
        edited();
    }
    function changedOnDisk(text, at) {
        seen = at;
        disk = text;
        theirs.textContent = text;
        conflict.hidden = false;
        edited();
    }
    async function look() {
        if (!name || desk.hidden || gone)
            return;
        const found = await post("/api/recordings/read", { name });
        if (found.name !== name || found.version === version || found.version === seen && !conflict.hidden)
            return;
        if (dirty())
            changedOnDisk(found.text, found.version);
        else
            take(found.text, found.version);
    }
    async function save(over) {
        const text = editor.text;
        const found = await post("/api/recordings/save", { name, text, version: over });
        if (found.conflict) {
            changedOnDisk(found.text, found.version);
            return;
        }
        [disk, version, seen] = [text, found.version, found.version];
        conflict.hidden = true;
        edited();
    }
    function edited() {
        number += 1;
        back.hidden = !dirty() || !conflict.hidden;
        keep.disabled = !dirty() || !conflict.hidden || gone;
        if (dirty())
            keepDraft();
        else
            sessionStorage.removeItem(`draft:${name}`);
        checking.dirty(dirty());
        count();
        clearTimeout(waiting);
        waiting = window.setTimeout(() => { void check(number); }, PAUSE);
    }
    async function check(asked) {
        if (gone)
            return;
        try {
            const found = await post("/api/recordings/check", { name, text: editor.text });
            if (asked !== number)
                return;
            unchecked = "";
            show(found);
        }
        catch (error) {
            if (asked !== number)
                return;
            unchecked = `not checked: ${error.message}`;
            count();
        }
    }
    let mistakes = 0;
    function count() {
        const kept = gone ? "its folder is gone: nothing can be saved" : dirty() ? "not saved" : "as on disk";
        state.textContent = `${kept} · ${unchecked ? unchecked : mistakes === 0 ? "no mistake" : mistakes === 1 ? "one mistake" : `${mistakes} mistakes`}`;
        state.classList.toggle("warning", mistakes > 0 || gone || unchecked !== "");
    }
    function show(found) {
        mistakes = found.mistakes.length;
        count();
        editor.mark(found.mistakes);
        told.replaceChildren(...(found.mistakes.length ? [h("ol", { class: "mistakes" }, ...found.mistakes.map((one) => h("li", {}, h("button", { type: "button", class: "quiet", click: () => editor.go(one.line) }, `line ${one.line}`), h("span", {}, ...coded(one.text)))))] : []), ...(found.remarks.length ? [h("ul", { class: "remarks" }, ...found.remarks.map((one) => h("li", { class: one.level === "warning" ? "warning" : "quiet" }, ...coded(one.text))))] : []));
        frame.expect(found.tags);
        const wanted = JSON.stringify([name, found.file, found.topic, found.family]);
        if (found.file && wanted !== film) {
            film = wanted;
            void frame.load(name, found.file, found.topic, found.family);
        }
        else if (!found.file && !found.mistakes.length)
            frame.none();
    }
    function use(ids) {
        const before = editor.text.replace(/\n*$/, "\n");
        editor.text = before + ids.map((id) => `\n[[tags.on_beam]]\nid = ${id}\ns = # place of its middle: 0 at the clamp, 1 at the tip\n`).join("");
        edited();
        editor.go(before.split("\n").length + 3);
    }
    function keepDraft() {
        sessionStorage.setItem(`draft:${title.textContent}`, JSON.stringify({ text: editor.text, version }));
    }
    function draftOf(wanted) {
        try {
            return JSON.parse(sessionStorage.getItem(`draft:${wanted}`) ?? "null");
        }
        catch {
            return null;
        }
    }
    function hear(message) {
        if (message.what === "places")
            void fill();
        if (message.what === "saved" && message.name === name && message.version !== version)
            void look();
        if (message.what === "work" && message.room === "check")
            checking.hear(message.job);
    }
    function keys(event) {
        if (!(event.ctrlKey || event.metaKey) || event.key.toLowerCase() !== "s")
            return;
        event.preventDefault();
        if (desk.hidden)
            return;
        if (!keep.disabled)
            void save(version);
        else if (gone)
            say(`The folder ${name} is gone: nothing was saved.`);
        else if (!conflict.hidden)
            say("Say first which text is to stay.");
    }
    const focus = () => { if (!document.hidden)
        void (desk.hidden ? fill() : look()); };
    document.addEventListener("keydown", keys);
    document.addEventListener("visibilitychange", focus);
    window.addEventListener("focus", focus);
    atEnd(() => document.removeEventListener("keydown", keys), () => document.removeEventListener("visibilitychange", focus), () => window.removeEventListener("focus", focus), listen(hear), onReturn(() => { void fill(); void look(); void checking.look(); }), () => { clearTimeout(waiting); editor.end(); frame.end(); });
}
