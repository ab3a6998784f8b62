// The modules of web/ts import what the table of docs/ARCHITECTURE.md says, and nothing else. Read with the compiler's own
// parser: static, dynamic and type imports, exports, and the addresses of workers.
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

/** Imports of all modules of a project against a table, as sentences about those that break it. */
function broken(folder, layers, generated) {
  const api = new API({ cwd: folder });
  try {
    const snapshot = api.updateSnapshot({ openProject: join(folder, "tsconfig.json") });
    const [project] = snapshot.getProjects();
    const sentences = [];
    for (const path of project.rootFiles) {
      const module = relative(join(folder, "ts"), path).replaceAll("\\", "/").replace(/\.ts$/, "");
      const may = layers.get(module);
      if (!may) {
        sentences.push(`${module} is not in the table`);
        continue;
      }
      for (const name of moduleNames(project.program.getSourceFile(path))) {
        const target = posix.join(dirname(module), name).replace(/\.[jt]s$/, "");
        const isFine = name.startsWith(".") ? may.includes(target) || (generated.get(target) === module) : module === `adapters/${name}`;
        if (!isFine) sentences.push(`${module} imports ${name}`);
      }
    }
    const known = project.rootFiles.map((path) => relative(join(folder, "ts"), path).replaceAll("\\", "/").replace(/\.ts$/, ""));
    for (const [module, may] of layers) {
      if (!known.includes(module)) sentences.push(`${module} of the table does not exist`);
      const above = [...layers.keys()].slice(0, [...layers.keys()].indexOf(module));
      for (const name of may) if (!above.includes(name)) sentences.push(`${module} may import ${name}, which is not above it in the table`);
    }
    return sentences;
  } finally {
    api.close();
  }
}

test("web/ts keeps to its layers", async () => {
  const layers = await table("Modules of `web/ts`");
  // Only the two `raw` know the generated bindings.
  assert.deepEqual(broken(join(root, "web"), layers, new Map([["landline", "raw"], ["mapper/landline_mapper", "mapper/raw"]])), []);
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
  assert.deepEqual(broken(folder, layers, new Map()), ["adapters/three imports ../low.js"]);
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
    const sentences = broken(folder, layers, new Map());
    assert.ok(sentences.includes(`low imports ${what}`), `${text}: ${sentences}`);
  }
});
