// Which build of the engine runs, why, and that no other one is downloaded.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { blank, haveSample } from "./page.mjs";
import { installed } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

/** Makes the page a browser that does not know the instruction of the relaxed build, as Safari did not before 27.3. */
const withoutRelaxedSimd = () => {
  const { validate } = WebAssembly;
  const isRelaxed = (bytes) => bytes.some((byte, i) => byte === 0xfd && bytes[i + 1] === 0x85 && bytes[i + 2] === 0x02);
  WebAssembly.validate = (bytes) => !isRelaxed(new Uint8Array(bytes)) && validate(bytes);
};

/** What a page learns of the builds when it asks for one. */
const ask = (page, options) =>
  page.evaluate(async (options) => {
    const events = [];
    try {
      const relocalizer = await globalThis.make({ ...options, onProgress: (event) => events.push(event) });
      const result = await relocalizer.locate({ data: new Uint8Array(64 * 64), width: 64, height: 64, format: "luma8" });
      await relocalizer.dispose();
      const { build, buildReason } = events.find(({ status }) => status === "ready");
      return { build, buildReason, same: result.build === build && result.buildReason === buildReason && relocalizer.build === build && relocalizer.buildReason === buildReason };
    } catch (error) {
      return { code: error.code, message: error.message };
    }
  }, options);

const engines = (server) => server.requests.filter(({ path }) => path.endsWith(".wasm")).map(({ path }) => path.split("/").at(-1));

test("a browser with relaxed SIMD loads the relaxed build and no other", { skip, timeout: 240_000 }, async (t) => {
  const { page, server } = await blank(t);
  assert.deepEqual(await ask(page, {}), { build: "relaxed", buildReason: "this browser has relaxed SIMD", same: true });
  assert.deepEqual(engines(server), ["landline_relaxed_bg.wasm"]);
  assert.deepEqual(await ask(page, { build: "plain" }), { build: "plain", buildReason: "the plain build was asked for", same: true });
  assert.deepEqual(engines(server), ["landline_relaxed_bg.wasm", "landline_bg.wasm"]);
  const given = await ask(page, { wasm: "./vendor/landline/landline_bg.wasm" });
  assert.deepEqual(given, { build: "plain", buildReason: "the caller gave the engine", same: true });
  assert.match((await ask(page, { build: "fast" })).message, /build is "fast", expected auto, plain or relaxed/);
});

test("a browser without relaxed SIMD loads the plain build, and says why", { skip, timeout: 240_000 }, async (t) => {
  const { page, server } = await blank(t);
  await page.evaluate(withoutRelaxedSimd);
  assert.deepEqual(await ask(page, {}), { build: "plain", buildReason: "this browser has no relaxed SIMD", same: true });
  assert.deepEqual(engines(server), ["landline_bg.wasm"]);
  const refused = await ask(page, { build: "relaxed" });
  assert.equal(refused.code, "unsupported");
  assert.match(refused.message, /no relaxed SIMD/);
  const support = await page.evaluate(() => globalThis.landline.checkSupport());
  assert.equal(support.ok, true);
  assert.equal(support.wasmRelaxedSimd, false);
  assert.match(support.reasons.join(" "), /no relaxed SIMD; the plain build/);
});

test("the probe tells whether the relaxed build can be compiled", { timeout: 120_000 }, async (t) => {
  const folder = join(await installed(t), "node_modules/landline");
  const { checkSupport, packagedWasmUrl } = await import(pathToFileURL(join(folder, "index.js")));
  const { wasmRelaxedSimd } = await checkSupport();
  assert.equal(WebAssembly.validate(readFileSync(join(folder, "landline_relaxed_bg.wasm"))), wasmRelaxedSimd);
  assert.equal(packagedWasmUrl().href.endsWith("landline_relaxed_bg.wasm"), wasmRelaxedSimd);
  assert.ok(WebAssembly.validate(readFileSync(join(folder, "landline_bg.wasm"))));
});
