// Builds ../page_template.html, which is shipped: style, three and the page's own modules in one file.
// Usage: npm ci && npm run build

import { createHash } from "node:crypto";
import { readFileSync, readdirSync, writeFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

import { build } from "esbuild";

const here = (path) => fileURLToPath(new URL(path, import.meta.url));
const TARGET = here("../page_template.html");

// A test compares this with the sources beside the template, so that the two cannot drift apart.
function digest() {
  const hash = createHash("sha256");
  const sources = readdirSync(here("src")).sort().map((name) => `src/${name}`);
  for (const path of ["build.mjs", "package-lock.json", "package.json", ...sources]) {
    hash.update(`${path}\n`).update(readFileSync(here(path)));
  }
  return hash.digest("hex");
}

const bundled = await build({
  entryPoints: [here("src/main.js")],
  bundle: true,
  minify: true,
  format: "iife",
  target: "es2022",
  legalComments: "none",
  write: false,
});
const style = await build({ entryPoints: [here("src/style.css")], minify: true, write: false });
const licence = readFileSync(here("node_modules/three/LICENSE"), "utf8").trim();

const script = bundled.outputFiles[0].text.trim();
if (/<\/script|<!--/i.test(script)) throw new Error("the script would end the element that holds it");
const page = readFileSync(here("src/page.html"), "utf8")
  .replace("/*STYLE*/", () => style.outputFiles[0].text.trim())
  .replace("<!--LICENCE-->", () => `<!--\nThis page holds three.js:\n\n${licence}\n-->`)
  .replace("SOURCES", () => digest())
  .replace("/*SCRIPT*/", () => script);
writeFileSync(TARGET, page);
console.log(`${TARGET}: ${page.length} bytes`);
