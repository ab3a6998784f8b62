// The modules of web/ts and of www import what the tables of docs/ARCHITECTURE.md say, and nothing else. Read with the
// compiler's own parser: static, dynamic and type imports, exports, and the addresses of workers.
import assert from "node:assert/strict";
import { mkdir, mkdtemp, readFile, realpath, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { dirname, join, posix, relative } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { root, tools } from "./support.mjs";

const load = (name) => import(pathToFileURL(tools.resolve(name)).href);
const { API } = await load("typescript/unstable/sync");
const { SyntaxKind } = await load("typescript/unstable/ast");

/** Module → what it may import, in the order of the table that follows a heading. */
async function table(heading) {
  const text = await readFile(join(root, "docs/ARCHITECTURE.md"), "utf8");
  const [, after] = text.split(`${heading}:`);
  assert.ok(after, `docs/ARCHITECTURE.md has no "${heading}:"`);
  const rows = after.slice(after.indexOf("| module |")).split("\n").slice(2);
  const layers = new Map();
  for (const row of rows.slice(0, rows.findIndex((line) => !line.startsWith("|")))) {
    const [module, may] = row.split("|").slice(1, 3).map((cell) => cell.trim());
    const names = may === "nothing" ? [] : may === "all of the above" ? [...layers.keys()] : may.split(",").map((name) => name.trim().replaceAll("`", ""));
    layers.set(module.replaceAll("`", ""), names);
  }
  return layers;
}

/** What tables name beside modules. */
const packages = ["landline", "landline/mapper", "landline/place", "three"];

/** Everything in a source file that names another module, and what cannot be told. */
function moduleNames(file) {
  const found = [];
  const visit = (node) => {
    if (node.kind === SyntaxKind.StringLiteral || node.kind === SyntaxKind.NoSubstitutionTemplateLiteral) {
      const { parent, text } = node;
      // A path to a script is one wherever it stands: in an import, in `import()`, in a type, as the address of a worker.
      const isModule = parent.moduleSpecifier === node || parent.kind === SyntaxKind.ExternalModuleReference || (parent.kind === SyntaxKind.LiteralType && parent.parent.kind === SyntaxKind.ImportType);
      if (isModule || /^\.{1,2}\/.*\.[cm]?[jt]sx?$/.test(text)) found.push(text);
    }
    if (node.kind === SyntaxKind.CallExpression && node.expression.kind === SyntaxKind.ImportKeyword) {
      const [argument] = node.arguments;
      if (argument?.kind !== SyntaxKind.StringLiteral) found.push("(computed)");
      else if (!/^\./.test(argument.text)) found.push(argument.text);
    }
    node.forEachChild(visit);
  };
  file.forEachChild(visit);
  for (const { fileName } of file.referencedFiles) found.push(`./${fileName}`);
  return found;
}

/**
 * Imports of all modules of a project against a table, as sentences about those that break it. `isOther` says of a name that
 * is no module of `source` whether a module may import it; `undefined` if it has nothing to say.
 */
function broken(folder, layers, isOther, source = join(folder, "ts")) {
  const api = new API({ cwd: folder });
  try {
    const snapshot = api.updateSnapshot({ openProject: join(folder, "tsconfig.json") });
    const [project] = snapshot.getProjects();
    const sentences = [];
    const moduleOf = (path) => relative(source, path).replaceAll("\\", "/").replace(/\.[jt]s$/, "");
    const known = project.rootFiles.map(moduleOf);
    for (const path of project.rootFiles) {
      const module = moduleOf(path);
      const may = layers.get(module);
      if (!may) {
        sentences.push(`${module} is not in the table`);
        continue;
      }
      for (const name of moduleNames(project.program.getSourceFile(path))) {
        const target = posix.join(dirname(module), name).replace(/\.[jt]s$/, "");
        if (!(isOther(module, name, target, may) ?? may.includes(target))) sentences.push(`${module} imports ${name}`);
      }
    }
    for (const [module, may] of layers) {
      if (!known.includes(module)) sentences.push(`${module} of the table does not exist`);
      const above = [...layers.keys()].slice(0, [...layers.keys()].indexOf(module));
      for (const name of may) if (!above.includes(name) && !packages.includes(name)) sentences.push(`${module} may import ${name}, which is not above it in the table`);
    }
    return sentences;
  } finally {
    api.close();
  }
}

/** In `web/ts`: an adapter imports the library that it is for, and a `raw` its generated bindings. */
const ofPackage = (generated) => (module, name, target) => {
  if (!name.startsWith(".")) return module === `adapters/${name}`;
  return generated.has(target) ? generated.get(target) === module : undefined;
};

/** In `www`: packages by their names in the table, `three` with its addons; the package's own files where no import map helps. */
const ofPage = (_module, name, target, may) => {
  if (!name.startsWith(".")) return may.includes(name.replace(/^three\/.*/, "three"));
  return /(^|\/)vendor\/landline\//.test(target) ? may.includes("landline") : undefined;
};

test("web/ts keeps to its layers", async () => {
  const layers = await table("Modules of `web/ts`");
  // Only the two `raw` know the generated bindings.
  const generated = new Map([["landline", "raw"], ["mapper/landline_mapper", "mapper/raw"]]);
  assert.deepEqual(broken(join(root, "web"), layers, ofPackage(generated)), []);
});

test("the demo page keeps to its layers", async (t) => {
  const folder = await realpath(await mkdtemp(join(tmpdir(), "landline-layers-")));
  t.after(() => rm(folder, { recursive: true, force: true }));
  const source = join(root, "www");
  const compilerOptions = { target: "ES2022", module: "ESNext", moduleResolution: "bundler", allowJs: true, noEmit: true, types: [] };
  await writeFile(join(folder, "tsconfig.json"), JSON.stringify({ compilerOptions, include: [source], exclude: [join(source, "vendor")] }));
  const layers = await table("Modules of `www`");
  assert.deepEqual(broken(folder, layers, ofPage, source), []);
  // A row less is a forbidden import more: the comparison bites here too.
  layers.set("strip", ["dom"]);
  layers.set("view3d", ["overlay"]);
  assert.deepEqual([...new Set(broken(folder, layers, ofPage, source))].filter((s) => !s.includes("addons")), ["strip imports ./session.js", "view3d imports three"]);
});

test("no way to import slips through", async (t) => {
  const folder = await realpath(await mkdtemp(join(tmpdir(), "landline-layers-")));
  t.after(() => rm(folder, { recursive: true, force: true }));
  await mkdir(join(folder, "ts/adapters"), { recursive: true });
  const write = (name, text) => writeFile(join(folder, name), text);
  await write("tsconfig.json", '{ "compilerOptions": { "target": "ES2022", "module": "ESNext", "moduleResolution": "bundler", "noEmit": true, "types": [] }, "include": ["ts"] }');
  await write("ts/low.ts", "export const a = 1;\n// import { x } from \"./high.js\"\nexport const text = 'import \"./high.js\" is only text';\n");
  await write("ts/high.ts", 'export * from "./low.js";\n');
  await write("ts/adapters/three.ts", 'import type { Camera } from "three";\nimport { a } from "../low.js";\nexport const b: Camera | number = a;\n');
  const layers = new Map([["low", []], ["high", ["low"]], ["adapters/three", ["high"]]]);
  assert.deepEqual(broken(folder, layers, ofPackage(new Map())), ["adapters/three imports ../low.js"]);
  for (const [text, what] of [
    ['import { a } from "./high.js";', "./high.js"],
    ['import type { a } from "./high.js";', "./high.js"],
    ['import "./high.js";', "./high.js"],
    ['export { a } from "./high.js";', "./high.js"],
    ['export type * from "./high.js";', "./high.js"],
    ['export type T = typeof import("./high.js").a;', "./high.js"],
    ['export const later = () => import("./high.js");', "./high.js"],
    ["export const later = () => import(`./high.js`);", "./high.js"],
    ['export const name: string = "x"; export const later = () => import(name);', "(computed)"],
    ['export const worker = () => new Worker(new URL("./high.js", import.meta.url));', "./high.js"],
    ['import * as THREE from "three"; export { THREE };', "three"],
    ['import raw = require("./high.js"); export { raw };', "./high.js"],
    ['/// <reference path="./high.ts" />', "././high.ts"],
  ]) {
    await write("ts/low.ts", `${text}\n`);
    const sentences = broken(folder, layers, ofPackage(new Map()));
    assert.ok(sentences.includes(`low imports ${what}`), `${text}: ${sentences}`);
  }
});
