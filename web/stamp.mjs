// Writes beside the built files which sources they were made from; tests/studio/test_build.py compares.
import { createHash } from "node:crypto";
import { copyFileSync, readdirSync, readFileSync, writeFileSync } from "node:fs";

const page = "../src/onebend/studio/page/";
for (const name of ["index.html", "page.css"]) copyFileSync(`src/${name}`, page + name);
const sources = {};
for (const name of readdirSync("src").sort()) {
  sources[name] = createHash("sha256").update(readFileSync(`src/${name}`)).digest("hex");
}
writeFileSync(`${page}sources.json`, JSON.stringify(sources, null, 1) + "\n");
