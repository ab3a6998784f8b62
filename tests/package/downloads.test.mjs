// Downloads that go wrong, files that change on their server, and arguments that make no sense.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";
import { blank, haveSample } from "./page.mjs";
import { site } from "./support.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";
const scene = () => readFileSync(join(site(), "scenes/sample/sample.landline"));

/** Loads the sample scene and says what became of it: its error, or where it came from. */
const load = (page, options = {}) =>
  page.evaluate(async (options) => {
    let done;
    const onProgress = (event) => {
      if (event.status === "done" && event.file === "scene") done = event;
    };
    const code = await globalThis.failure(globalThis.make({ onProgress, ...options }).then((relocalizer) => relocalizer.dispose()));
    const kept = await globalThis.landline.isCached(options.scene ?? "./scenes/sample/sample.landline");
    return { code, fromCache: done?.fromCache, unchecked: done?.unchecked === true, kept };
  }, options);

test("a wrong answer of the server is not kept, and heals with the server", { skip, timeout: 240_000 }, async (t) => {
  const { page, server } = await blank(t);
  for (const body of [scene().subarray(0, 50_000), "maintenance"]) {
    server.state.faults = { ".landline": { body } };
    assert.deepEqual(await load(page), { code: "scene-corrupt", fromCache: false, unchecked: false, kept: false });
  }
  server.state.faults = {};
  assert.deepEqual(await load(page), { code: "no error", fromCache: false, unchecked: false, kept: true });
  // An entry from before files were checked, under its own checksum: found out, dropped, and loaded again.
  await page.evaluate(async () => {
    const cache = await caches.open("landline-v1");
    const key = (await cache.keys()).find(({ url }) => url.endsWith(".landline"));
    const headers = new Headers((await cache.match(key)).headers);
    const bytes = new TextEncoder().encode("maintenance");
    const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
    headers.set("x-landline-sha256", Array.from(digest, (b) => b.toString(16).padStart(2, "0")).join(""));
    await cache.put(key, new Response(bytes, { headers }));
  });
  assert.deepEqual(await load(page), { code: "no error", fromCache: false, unchecked: false, kept: true });
});

test("a scene that was taught anew arrives; without its server the old one serves", { skip, timeout: 240_000 }, async (t) => {
  const { page, server } = await blank(t);
  assert.equal((await load(page)).fromCache, false);
  assert.deepEqual(await load(page), { code: "no error", fromCache: true, unchecked: false, kept: true });
  server.state.faults = { ".landline": { body: rewritten(scene()) } };
  assert.deepEqual(await load(page), { code: "no error", fromCache: false, unchecked: false, kept: true });
  assert.equal((await load(page)).fromCache, true);
  // Out of order in two ways: the kept one serves, and it is said that nobody could be asked.
  const unchecked = { code: "no error", fromCache: true, unchecked: true, kept: true };
  server.state.faults = { ".landline": { status: 503 } };
  assert.deepEqual(await load(page), unchecked);
  server.state.faults = { ".landline": { body: "<!doctype html><title>Sign in</title>" } };
  assert.deepEqual(await load(page), unchecked);
});

/** The scene with a space more in its header: other bytes, the same content. */
function rewritten(bytes) {
  const length = Number(bytes.readBigUInt64LE(0));
  const head = Buffer.alloc(8);
  head.writeBigUInt64LE(BigInt(length + 8));
  return Buffer.concat([head, bytes.subarray(8, 8 + length), Buffer.from(" ".repeat(8)), bytes.subarray(8 + length)]);
}

test("downloads that stall, never end or announce too much are given up", { skip, timeout: 240_000 }, async (t) => {
  const { page, server } = await blank(t);
  const message = (options) => page.evaluate((options) => globalThis.make({ cache: "none", ...options }).then(() => "no error", (e) => `${e.code}: ${e.message}`), options);
  server.state.faults = { ".landline": { stallAt: 1000 } };
  assert.match(await message({ stallTimeoutMs: 500 }), /^asset-fetch: the scene .* stopped arriving after 1000 bytes: nothing came for 0.5 s$/);
  server.state.faults = { ".landline": { announce: 2 ** 40, stallAt: 10 } };
  assert.match(await message(), /^asset-fetch: the scene .* is larger than 512 MiB: 1099511627776 bytes are announced$/);
  server.state.faults = { ".landline": { endless: true } };
  assert.match(await message(), /^asset-fetch: the scene .* is larger than 512 MiB$/);
  server.state.faults = { "landline_bg.wasm": { stallAt: 1000 } };
  // Under another address, as the engine of the first is compiled already.
  assert.match(await message({ stallTimeoutMs: 500, wasm: "./vendor/landline/landline_bg.wasm?again" }), /^asset-fetch: the engine .* stopped arriving: nothing came for 0.5 s$/);
  server.state.faults = {};
  assert.equal(await message({ wasm: "./vendor/landline/landline_bg.wasm?again" }), "no error", "nothing of it is remembered");
});

test("arguments are refused by their name, and the next call works", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const outcome = await page.evaluate(async () => {
    const relocalizer = await globalThis.make();
    const frame = { data: new Uint8Array(64 * 64), width: 64, height: 64, format: "luma8" };
    const told = (promise) => promise.then(() => "no error", (e) => `${e.code}: ${e.message}`);
    const calls = {
      include: () => relocalizer.locate(frame, { include: "points" }),
      camera: () => relocalizer.locate(frame, { camera: 5 }),
      timestamp: () => relocalizer.locate(frame, { timestamp: 12n }),
      unknown: () => relocalizer.locate(frame, { intrinsic: {} }),
      recall: () => relocalizer.recallCamera(5, 0.8),
      focal: () => relocalizer.recallCamera("a", NaN),
      seed: () => relocalizer.setOptions({ seed: 5n }),
      side: () => relocalizer.setOptions({ maxSide: NaN }),
      large: () => relocalizer.setOptions({ maxSide: 8192 }),
      budget: () => relocalizer.setOptions({ timeBudgetMs: Infinity }),
      error: () => relocalizer.setOptions({ maxLineErrorPx: Infinity }),
      smoothing: () => relocalizer.setOptions({ smoothing: null }),
      misspelt: () => relocalizer.setOptions({ smothing: "steady" }),
      create: () => globalThis.make({ device: "tpu" }),
      signal: () => relocalizer.locate(frame, { signal: {} }),
      distortion: () => relocalizer.locate(frame, { intrinsics: { fx: 1, k1: 0 } }),
      integrity: () => globalThis.make({ integrity: { wasm: "sha256-" } }),
      promised: () => relocalizer.locate(Promise.resolve(frame)),
      follow: async () => landline.follow(globalThis.make(), document.createElement("video")),
      video: async () => landline.follow(relocalizer, "#video"),
      project: async () => landline.project(null, { fx: 1, fy: 1, cx: 0, cy: 0 }, [0, 0, 1]),
      matrix: async () => landline.placementFrom([1, 2]),
      numbers: async () => landline.invertRigid(new Float64Array(16).fill(NaN)),
      engine: async () => globalThis.make({ worker: false, wasm: new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0]) }),
    };
    const seen = {};
    const { landline } = globalThis;
    for (const [name, call] of Object.entries(calls)) seen[name] = await told(call());
    seen.after = (await relocalizer.locate(frame)).reason;
    seen.plain = await told(globalThis.make({ worker: false }));
    return seen;
  });
  const bad = (text) => `bad-input: ${text}`;
  assert.deepEqual(outcome, {
    include: bad('option include is "points", expected a list of points, lines or segments'),
    camera: bad("option camera is 5, expected a string"),
    timestamp: bad("option timestamp is 12n, expected a finite number of milliseconds"),
    unknown: bad('locate() has no option "intrinsic"'),
    recall: bad("camera is 5, expected a string"),
    focal: bad("focalPerWidth is NaN, expected a finite number above 0"),
    seed: bad("option seed is 5n, expected a whole number that is not negative"),
    side: bad("option maxSide is NaN, expected a whole number of pixels from 1 to 2048"),
    large: bad("option maxSide is 8192, expected a whole number of pixels from 1 to 2048"),
    budget: bad("option timeBudgetMs is Infinity, expected a finite number of milliseconds that is not negative"),
    error: bad("option maxLineErrorPx is Infinity, expected a finite number of pixels above 0"),
    smoothing: bad("option smoothing is null, expected off, steady or responsive"),
    misspelt: bad('setOptions() has no option "smothing"'),
    create: bad('option device is "tpu", expected auto, webgpu or cpu'),
    signal: bad("option signal is {}, expected an AbortSignal"),
    distortion: bad('option intrinsics is {"fx":1,"k1":0}, expected { fx, fy, cx, cy, width, height, source, relativeSigma }'),
    integrity: bad('option integrity is {"wasm":"sha256-"}, expected { scene, extractor }'),
    promised: bad("the frame is a Promise (an await is missing)"),
    follow: bad("the relocalizer is a Promise (an await is missing), expected a Relocalizer or a Place"),
    video: bad('the video is "#video", expected a video element'),
    project: bad("the placement is null"),
    matrix: bad("the matrix has 2 numbers or some that are none"),
    numbers: bad("the matrix has 16 numbers or some that are none"),
    engine: "engine-version: the engine's wasm file has no memory",
    after: "few-features",
    plain: "no error",
  });
});
