// Code as it is printed in the documents.
import { readFile, readdir } from "node:fs/promises";
import { join } from "node:path";
import { root } from "./support.mjs";

/** Every document whose code somebody may copy. */
export async function documents() {
  const all = ["README.md", "pkg-config/README.npm.md"];
  for (const folder of ["examples", "docs/guides"]) {
    for (const name of await readdir(join(root, folder), { recursive: true })) if (name.endsWith(".md")) all.push(`${folder}/${name.replaceAll("\\", "/")}`);
  }
  return all;
}

/** The fenced blocks of a document: language and text. */
export async function snippets(document) {
  const text = await readFile(join(root, document), "utf8");
  return [...text.matchAll(/^```(\w+)\n([\s\S]*?)^```$/gm)].map(([, language, code]) => ({ language, code }));
}

/** The one snippet of a document that has some text in it. */
export async function snippet(document, holds) {
  const found = (await snippets(document)).filter(({ code }) => code.includes(holds));
  if (found.length !== 1) throw new Error(`${document} has ${found.length} snippets with ${JSON.stringify(holds)}`);
  return found[0].code;
}
