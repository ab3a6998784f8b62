// Types of web/ts that carry a word which could mean two things stand in the table of docs/CONVENTIONS.md; tests/native/words.rs
// does so for Rust. Read with the compiler's own parser.
import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { root, tools } from "./support.mjs";

const load = (name) => import(pathToFileURL(tools.resolve(name)).href);
const { API } = await load("typescript/unstable/sync");
const { SyntaxKind } = await load("typescript/unstable/ast");
const TYPES = [SyntaxKind.InterfaceDeclaration, SyntaxKind.TypeAliasDeclaration, SyntaxKind.ClassDeclaration, SyntaxKind.EnumDeclaration];

/** Names of all types of a project. */
function types(folder) {
  const api = new API({ cwd: folder });
  try {
    const [project] = api.updateSnapshot({ openProject: join(folder, "tsconfig.json") }).getProjects();
    const found = [];
    const visit = (node) => {
      if (TYPES.includes(node.kind) && node.name) found.push(node.name.text);
      node.forEachChild(visit);
    };
    for (const path of project.rootFiles) project.program.getSourceFile(path).forEachChild(visit);
    return found;
  } finally {
    api.close();
  }
}

/** `TrackedFrame` → `tracked`, `frame`. */
const parts = (name) => name.split(/(?<=[a-z0-9])(?=[A-Z])/).map((part) => part.toLowerCase());

test("types of web/ts carry the words of the conventions", async () => {
  const text = await readFile(join(root, "docs/CONVENTIONS.md"), "utf8");
  const [, after] = text.split("| word | types in Rust | types in TypeScript |\n");
  assert.ok(after, "docs/CONVENTIONS.md has no table of types");
  const lines = after.split("\n").slice(1);
  const rows = lines.slice(0, lines.findIndex((line) => !line.startsWith("|")));
  const names = types(join(root, "web"));
  assert.ok(names.length > 50 && rows.length > 3);
  for (const row of rows) {
    const [word, , may] = row.split("|").slice(1).map((cell) => cell.trim());
    const carried = names.filter((name) => parts(name).some((part) => new RegExp(`^${word}(s|er|ed|ing)?$`).test(part)));
    const fits = (name) => [...may.matchAll(/`(\w+)\*`/g)].some(([, start]) => name.startsWith(start));
    const listed = [...may.matchAll(/`(\w+)`/g)].map(([, name]) => name);
    assert.deepEqual([...new Set(carried)].filter((name) => !fits(name)).sort(), listed.sort(), `${word}: read what it means in docs/CONVENTIONS.md, then rename the type or add it to the table there`);
  }
});

test("every reason and every code stands in the package's page", async () => {
  const read = (name) => readFile(join(root, name), "utf8");
  const [types, errors, page] = await Promise.all(["web/ts/types.ts", "web/ts/errors.ts", "pkg-config/README.npm.md"].map(read));
  const union = (text, name) => [...text.split(`export type ${name} =`)[1].split(";\n\n")[0].matchAll(/^ *\| "([a-z-]+)"/gm)].map(([, word]) => word);
  const words = [...union(types, "NotLocatedReason"), ...union(errors, "LandlineErrorCode")];
  assert.ok(words.includes("turned") && words.includes("aborted"), `read ${words}`);
  const rows = page.split("\n").filter((line) => line.startsWith("| `"));
  assert.deepEqual(words.filter((word) => !rows.some((row) => row.split("|")[1].includes(`\`${word}\``))), []);
});
