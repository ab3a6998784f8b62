// The conformance page: every vector is located near its truth, in Chromium and under Node with the same bits.
import assert from "node:assert/strict";
import { createHash } from "node:crypto";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { browser, haveSample, open, serve } from "./page.mjs";
import { installed, site } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("the test vectors give the same poses under Node and in Chromium", { skip, timeout: 240_000 }, async (t) => {
  const server = await serve(t);
  const { page, said } = await open(await browser(t), `${server.url}conformance/index.html`);
  await page.waitForFunction(() => globalThis.conformance !== undefined);
  const { text, runs } = await page.evaluate(() => ({ text: globalThis.conformance.text, runs: globalThis.conformance.runs }));
  t.diagnostic(text);
  const [cpu] = runs;
  const { vectors, intrinsics } = JSON.parse(await readFile(join(site(), "conformance/vectors.json"), "utf8"));
  assert.equal(cpu.located, vectors.length, `${text} ${cpu.offCm}`);
  assert.ok(cpu.worstCm < 15, text);
  assert.deepEqual(said, []);

  const { Relocalizer } = await import(pathToFileURL(join(await installed(t), "node_modules/landline/index.js")));
  // The page's own pixels: Node has no decoder.
  const frames = await page.evaluate(() => globalThis.conformance.frames.map(({ data, ...frame }) => ({ ...frame, text: btoa(Array.from(data, (v) => String.fromCharCode(v)).join("")) })));
  const relocalizer = await Relocalizer.create({ scene: join(site(), "scenes/sample/sample.landline"), device: "cpu" });
  const hash = createHash("sha256");
  for (const { text: encoded, ...frame } of frames) {
    await relocalizer.reset();
    const { placement } = await relocalizer.locate({ ...frame, data: new Uint8Array(Buffer.from(encoded, "base64")) }, { intrinsics });
    hash.update(new Uint8Array(placement.cameraFromWorld.buffer, placement.cameraFromWorld.byteOffset, placement.cameraFromWorld.byteLength));
  }
  await relocalizer.dispose();
  assert.equal(hash.digest("hex").slice(0, 16), cpu.digest, "the bits of Node and Chromium");
});
