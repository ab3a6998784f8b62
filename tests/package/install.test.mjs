// The packed tarball, installed in an empty folder and used by name.
import assert from "node:assert/strict";
import { readFile, readdir, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { installed, root, run } from "./support.mjs";

/** Runs a script in the folder; it must end well and say nothing on stderr. */
async function node(folder, script) {
  await writeFile(join(folder, "script.mjs"), script);
  const { status, stdout, stderr } = await run(process.execPath, ["script.mjs"], folder);
  assert.equal(stderr, "", "a library is silent");
  assert.equal(status, 0, stdout);
  return JSON.parse(stdout);
}

test("is imported by name and says what it has", async (t) => {
  const folder = await installed(t);
  const names = await node(folder, `import * as all from "landline"; console.log(JSON.stringify(Object.keys(all)));`);
  for (const name of ["Relocalizer", "LandlineError", "checkSupport", "camera"]) assert.ok(names.includes(name), name);
});

test("refuses a scene that is none, with a code", async (t) => {
  const folder = await installed(t);
  const error = await node(folder, `
    import { Relocalizer } from "landline";
    const scene = new TextEncoder().encode("this is no scene file, whatever its name may be");
    const error = await Relocalizer.create({ scene, device: "cpu" }).then(() => null, (e) => e);
    console.log(JSON.stringify({ name: error?.name, code: error?.code, hint: error?.hint, message: error?.message }));
  `);
  assert.equal(error.name, "LandlineError");
  assert.equal(error.code, "scene-corrupt", error.message);
  assert.notEqual(error.hint, "", "an error says what to do");
});

test("refuses a call without a scene", async (t) => {
  const folder = await installed(t);
  const code = await node(folder, `
    import { Relocalizer } from "landline";
    console.log(JSON.stringify(await Relocalizer.create({}).then(() => null, (e) => e.code)));
  `);
  assert.equal(code, "bad-input");
});

test("every export leads to a file", async (t) => {
  const folder = join(await installed(t), "node_modules/landline");
  const manifest = JSON.parse(await readFile(join(folder, "package.json"), "utf8"));
  const targets = Object.values(manifest.exports).flatMap((entry) => (typeof entry === "string" ? [entry] : Object.values(entry)));
  for (const target of targets) await readFile(join(folder, target));
  for (const entry of Object.values(manifest.exports)) {
    if (typeof entry === "object") assert.equal(Object.keys(entry)[0], "types", "TypeScript takes the first condition that matches");
  }
  assert.equal(manifest.dependencies, undefined, "nothing else is installed with it");
  assert.equal(manifest.scripts, undefined, "nothing runs at installation");
});

test("carries licences and the weights' notice, and nothing of the machine that built it", async (t) => {
  const folder = join(await installed(t), "node_modules/landline");
  const names = await readdir(folder, { recursive: true });
  for (const name of ["LICENSE-MIT", "LICENSE-APACHE", "XFEAT-LICENSE", "README.md"]) assert.ok(names.includes(name), name);
  assert.deepEqual(names.filter((name) => /\.(ts|map|tsbuildinfo)$/.test(name) && !name.endsWith(".d.ts")), []);
  for (const name of names.filter((name) => /\.(js|ts|json|wasm|safetensors)$/.test(name))) {
    const bytes = await readFile(join(folder, name));
    assert.ok(!bytes.includes(root), `${name} contains ${root}`);
  }
});

test("types compile under both module resolutions", async (t) => {
  const folder = await installed(t);
  await writeFile(join(folder, "use.ts"), `
    import { Relocalizer, LandlineError, type LocateResult } from "landline";
    import { Mapper } from "landline/mapper";
    import { Place } from "landline/place";
    const relocalizer = await Relocalizer.create({ scene: new Uint8Array(0) });
    relocalizer.addEventListener("tracking", ({ detail }) => console.log(detail.quality.keypoints));
    relocalizer.addEventListener("something", ({ type }) => console.log(type));
    console.log(Mapper.name, Place.name);
    const result: LocateResult = await relocalizer.locate(document.createElement("canvas"));
    if (result.located) console.log(result.placement?.position.x.toFixed(2), result.quality.pointInliers);
    else console.log(result.reason);
    console.log(new LandlineError("bad-input", "x").code);
    // @ts-expect-error a scene is needed
    await Relocalizer.create({});
    // @ts-expect-error codes are a closed list
    new LandlineError("no-such-code", "x");
  `);
  const tsc = join(root, "web/node_modules/typescript/bin/tsc");
  // What a new project has, with and without the newest names.
  const libs = [["es2023", "esnext.disposable", "dom", "dom.asynciterable"], ["es2022", "dom"]];
  for (const [module, moduleResolution] of [["esnext", "bundler"], ["nodenext", "nodenext"]]) for (const lib of libs) {
    const options = { module, moduleResolution, target: "es2022", lib, strict: true, noEmit: true, types: [] };
    await writeFile(join(folder, "tsconfig.json"), JSON.stringify({ compilerOptions: options, files: ["use.ts"] }));
    const { status, stdout } = await run(process.execPath, [tsc, "--project", "tsconfig.json"], folder);
    assert.equal(status, 0, `${moduleResolution}, ${lib}:\n${stdout}`);
  }
});
