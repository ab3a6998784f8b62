// The same pictures give the same poses natively, under Node and in Chromium.
import assert from "node:assert/strict";
import { existsSync } from "node:fs";
import { mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { test } from "node:test";
import { browser, haveSample, open, serve } from "./page.mjs";
import { installed, root, run, site } from "./support.mjs";

const native = process.env.LANDLINE_NATIVE ?? join(root, "target/debug/landline");
const skip = !haveSample() ? "the sample scene is not there: run `cargo xtask sample`" : !existsSync(native) ? "the native tool is not built: run `cargo xtask demo --no-serve`" : false;

/** Poses of the one wasm binary agree to this under Node and in Chromium, in metres and radians (entries of a rotation). */
const tolerance = 1e-6;
/**
 * The native networks sum their f32 products in another order than wasm does, and everything after them starts from
 * those numbers; on the sample the poses then differ by 1.9e-5 at most.
 */
const nativeTolerance = 1e-4;

const median = (values) => {
  const sorted = [...values].sort((a, b) => a - b);
  return (sorted[Math.floor((sorted.length - 1) / 2)] + sorted[Math.ceil((sorted.length - 1) / 2)]) / 2;
};

const center = (m) => [0, 1, 2].map((c) => -(m[c] * m[3] + m[4 + c] * m[7] + m[8 + c] * m[11]));

test("native, Node and Chromium agree on the sample pictures", { skip, timeout: 900_000 }, async (t) => {
  const sample = join(site(), "scenes/sample");
  const list = JSON.parse(await readFile(join(sample, "sample.json"), "utf8"));
  const folder = await mkdtemp(join(tmpdir(), "landline-parity-"));
  t.after(() => rm(folder, { recursive: true, force: true }));

  // JPEG decoders differ by a level here and there, so all three get the pixels that Chromium decoded.
  const server = await serve(t);
  const { page } = await open(await browser(t), `${server.url}files.json`);
  page.setDefaultTimeout(600_000);
  const inBrowser = [];
  for (const { name } of list.pictures) {
    const { rgba, png, pose } = await page.evaluate(
      async ({ name, camera }) => {
        globalThis.relocalizer ??= await (await import("/vendor/landline/index.js")).Relocalizer.create({ scene: "/scenes/sample/sample.landline", device: "cpu" });
        const bitmap = await createImageBitmap(await (await fetch(`/scenes/sample/${name}`)).blob(), { colorSpaceConversion: "none" });
        const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
        const context = canvas.getContext("2d", { alpha: false });
        context.drawImage(bitmap, 0, 0);
        const base64 = async (blob) => {
          const bytes = new Uint8Array(await blob.arrayBuffer());
          let text = "";
          for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
          return btoa(text);
        };
        const pixels = context.getImageData(0, 0, bitmap.width, bitmap.height);
        const result = await globalThis.relocalizer.locate(pixels, { intrinsics: camera });
        return {
          png: await base64(await canvas.convertToBlob({ type: "image/png" })),
          rgba: await base64(new Blob([pixels.data])),
          pose: result.placement ? [...result.placement.cameraFromWorld] : null,
        };
      },
      { name, camera: list.camera },
    );
    await writeFile(join(folder, `${name}.png`), Buffer.from(png, "base64"));
    inBrowser.push({ name, pose, rgba: Buffer.from(rgba, "base64") });
  }

  const { Relocalizer } = await import(pathToFileURL(join(await installed(t), "node_modules/landline/index.js")));
  const relocalizer = await Relocalizer.create({ scene: join(sample, "sample.landline") });
  const underNode = [];
  for (const { rgba } of inBrowser) {
    const { width, height } = list.camera;
    const result = await relocalizer.locate({ data: rgba, width, height, format: "rgba8" }, { intrinsics: list.camera });
    underNode.push(result.placement ? [...result.placement.cameraFromWorld] : null);
  }
  await relocalizer.dispose();

  await writeFile(join(folder, "list.json"), JSON.stringify({ ...list, pictures: list.pictures.map((p) => ({ ...p, name: `${p.name}.png` })) }));
  const extractor = join(site(), "vendor/landline/xfeat.safetensors");
  const result = await run(native, ["demo", "--json", "--dir", folder, "--list", join(folder, "list.json"), "--scene", join(sample, "sample.landline"), "--extractor", extractor], root);
  assert.equal(result.status, 0, result.stderr);
  const natively = JSON.parse(result.stdout);

  let worst = 0;
  let worstNative = 0;
  const errors = { native: [], node: [], chromium: [] };
  natively.forEach((row, i) => {
    const poses = { native: row.cam_from_world, node: underNode[i], chromium: inBrowser[i].pose };
    const truth = center(list.pictures[i].cam_from_world.flat());
    for (const [where, pose] of Object.entries(poses)) {
      errors[where].push(pose ? Math.hypot(...center(pose).map((v, k) => v - truth[k])) : Infinity);
      assert.equal(pose === null, poses.native === null, `${row.name}: located in one place and not in another`);
      if (pose) pose.forEach((v, k) => (worstNative = Math.max(worstNative, Math.abs(v - poses.native[k]))));
    }
    assert.equal(poses.node === null, poses.chromium === null, `${row.name}: located under Node or in Chromium only`);
    if (poses.node) {
      poses.node.forEach((v, k) => (worst = Math.max(worst, Math.abs(v - poses.chromium[k]))));
    }
  });
  for (const [where, values] of Object.entries(errors)) t.diagnostic(`${where}: median error ${(1000 * median(values)).toFixed(3)} mm over ${values.length} pictures`);
  t.diagnostic(`largest difference between two poses' entries: ${worst.toExponential(2)} (Node, Chromium), ${worstNative.toExponential(2)} (wasm, native)`);
  assert.ok(worst <= tolerance, `poses under Node and in Chromium differ by ${worst}`);
  assert.ok(worstNative <= nativeTolerance, `poses of wasm and native differ by ${worstNative}`);
});
