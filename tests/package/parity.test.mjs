// The same pictures give the same poses natively, under Node and in Chromium.
import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import { mkdtemp, readFile, rm } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test } from "node:test";
import { accuracy, apart, difference, posesInChromium, posesUnderNode, readFrames } from "../../xtask/node/poses.mjs";
import { browser, haveSample, open, serve } from "./page.mjs";
import { installed, root, run, site } from "./support.mjs";

const native = process.env.LANDLINE_NATIVE ?? join(root, "target/debug/landline");
const skip = !haveSample() ? "the sample scene is not there: run `cargo xtask sample`" : !existsSync(native) ? "the native tool is not built: run `cargo xtask demo --no-serve`" : false;

/**
 * Poses agree to this, in metres and radians (entries of a rotation). The native tool takes the kernels with the bits of
 * wasm; the machine's best sum their products in another order, and poses then differ by 2e-5.
 */
const tolerance = 1e-6;

test("native, Node and Chromium agree on the sample pictures", { skip, timeout: 900_000 }, async (t) => {
  const sample = join(site(), "scenes/sample");
  const scene = join(sample, "sample.landline");
  const list = JSON.parse(await readFile(join(sample, "sample.json"), "utf8"));
  const folder = await mkdtemp(join(tmpdir(), "landline-parity-"));
  t.after(() => rm(folder, { recursive: true, force: true }));

  // JPEG decoders differ by a level here and there, so all three get the pixels that the native tool decoded.
  const extractor = join(site(), "vendor/landline/xfeat.safetensors");
  const result = await run(native, ["demo", "--kernels", "portable", "--save", folder, "--dir", sample, "--extractor", extractor], root);
  assert.equal(result.status, 0, result.stderr);
  const frames = await readFrames(folder, list);
  const poses = { native: JSON.parse(await readFile(join(folder, "poses.json"), "utf8")).map((row) => row.cam_from_world) };
  poses.node = await posesUnderNode(join(await installed(t), "node_modules/landline"), scene, frames, list.camera);
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}files.json`);
  page.setDefaultTimeout(600_000);
  poses.chromium = await posesInChromium(page, "/scenes/sample/sample.landline", frames, list.camera);

  // The relaxed build adds products before they are rounded, in the networks only.
  poses.relaxed = await posesInChromium(page, "/scenes/sample/sample.landline", frames, list.camera, "relaxed");
  assert.equal(await page.evaluate(() => globalThis.relocalizer.build), "relaxed");
  const { mm, deg } = apart(poses.relaxed, poses.chromium);
  t.diagnostic(`relaxed and plain build: ${mm.toFixed(4)} mm and ${deg.toFixed(5)} degrees apart at most`);
  assert.ok(mm <= 0.1 && deg <= 0.002, `poses of the two builds are ${mm} mm and ${deg} degrees apart`);

  for (const [where, those] of Object.entries(poses)) {
    const { located, medianMm } = accuracy(those, list);
    t.diagnostic(`${where}: ${located} of ${those.length} located, median error ${medianMm.toFixed(3)} mm`);
  }
  for (const [a, b] of [["native", "node"], ["native", "chromium"], ["node", "chromium"]]) {
    const largest = difference(poses[a], poses[b]);
    t.diagnostic(`${a} and ${b}: entries of poses differ by ${largest.toExponential(1)} at most`);
    assert.ok(largest <= tolerance, `poses of ${a} and ${b} differ by ${largest}`);
  }
});
