// The package's interface in a browser: odd input, several instances, the cache, and many frames.
import assert from "node:assert/strict";
import { test } from "node:test";
import { blank, haveSample } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("odd frames get a typed error or a clear result, and the next frame works", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const outcome = await page.evaluate(async () => {
    const { failure } = globalThis;
    const relocalizer = await globalThis.make();
    const gray = (width, height) => ({ data: new Uint8Array(width * height), width, height, format: "luma8" });
    const seen = {};
    seen.zero = await failure(relocalizer.locate({ data: new Uint8Array(0), width: 0, height: 0, format: "luma8" }));
    seen.nothing = await failure(relocalizer.locate(null));
    seen.video = await failure(relocalizer.locate(document.createElement("video")));
    seen.short = await failure(relocalizer.locate({ data: new Uint8Array(10), width: 64, height: 64, format: "rgba8" }));
    seen.huge = await failure(relocalizer.locate({ data: new Uint8Array(0), width: 20000, height: 20000, format: "luma8" }));
    seen.focal = await failure(relocalizer.locate(gray(64, 64), { intrinsics: { fx: -1, fy: 1, cx: 0, cy: 0, width: 64, height: 64 } }));
    seen.shape = await failure(relocalizer.locate(gray(64, 64), { intrinsics: { fx: 50, fy: 50, cx: 0, cy: 0, width: 64, height: 32 } }));
    seen.time = await failure(relocalizer.locate(gray(64, 64), { timestamp: NaN }));
    seen.include = await failure(relocalizer.locate(gray(64, 64), { include: ["faces"] }));
    seen.source = await failure(relocalizer.locate(gray(64, 64), { intrinsics: { fx: 60, fy: 60, cx: 32, cy: 32 }, intrinsicsSource: "rumour" }));
    for (const [w, h] of [[1, 1], [31, 200], [640, 480], [33, 4000], [1921, 1081]]) {
      seen[`${w}x${h}`] = await relocalizer.locate(gray(w, h)).then((r) => r.reason, (e) => e.code);
    }
    const bitmap = await createImageBitmap(new ImageData(64, 64));
    seen.bitmap = (await relocalizer.locate(bitmap)).located;
    seen.kept = bitmap.width;
    await relocalizer.locate(bitmap, { transfer: true });
    seen.transferred = bitmap.width;
    seen.closed = await failure(relocalizer.locate(bitmap));
    const canvas = new OffscreenCanvas(64, 64);
    canvas.getContext("2d").fillRect(0, 0, 64, 64);
    const frame = new VideoFrame(canvas, { timestamp: 0 });
    seen.videoFrame = (await relocalizer.locate(frame)).located;
    frame.close();
    seen.options = await failure(relocalizer.setOptions({ maxSide: 3 }));
    seen.optionsLater = (await relocalizer.locate(gray(64, 64))).located;
    await relocalizer.dispose();
    return seen;
  });
  assert.deepEqual(outcome, {
    zero: "bad-input",
    nothing: "bad-input",
    video: "bad-input",
    short: "bad-input",
    huge: "bad-input",
    focal: "bad-input",
    shape: "bad-input",
    time: "bad-input",
    include: "bad-input",
    source: "bad-input",
    "1x1": "bad-input",
    "31x200": "bad-input",
    "640x480": "few-features",
    "33x4000": "bad-input",
    "1921x1081": "few-features",
    bitmap: false,
    kept: 64,
    transferred: 0,
    closed: "bad-input",
    videoFrame: false,
    options: "bad-input",
    optionsLater: false,
  });
});

test("two instances, disposal during frames, cancelling", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const outcome = await page.evaluate(async () => {
    const { failure, make } = globalThis;
    const frame = { data: new Uint8Array(320 * 240).map((_, i) => (i * 37) % 251), width: 320, height: 240, format: "luma8" };
    const [a, b] = await Promise.all([make(), make({ worker: false })]);
    const [first, second] = await Promise.all([a.locate(frame), b.locate(frame)]);
    const late = a.locate(frame);
    const also = a.locate(frame);
    await a.dispose();
    await a.dispose();
    const ended = [await failure(late), await failure(also), await failure(a.locate(frame))];
    const alive = (await b.locate(frame)).quality.keypoints;
    const own = b.locate(frame);
    const queued = b.locate(frame);
    await b.dispose();
    const onThisThread = [await failure(own), await failure(queued), await failure(b.setOptions({ seed: 1 }))];
    const stop = new AbortController();
    const cancelled = failure(make({ signal: stop.signal, cache: "none" }));
    stop.abort();
    const already = await failure(make({ signal: AbortSignal.abort() }));
    return { onThisThread, same: first.quality.keypoints === second.quality.keypoints, ended, alive: alive > 0, cancelled: await cancelled, already };
  });
  assert.deepEqual(outcome, { onThisThread: ["disposed", "disposed", "disposed"], same: true, ended: ["disposed", "disposed", "disposed"], alive: true, cancelled: "AbortError", already: "AbortError" });
});

test("a scene of another extractor, a later version, a damaged one", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const outcome = await page.evaluate(async () => {
    const { failure, make } = globalThis;
    const bytes = new Uint8Array(await (await fetch("./scenes/sample/sample.landline")).arrayBuffer());
    const length = Number(new DataView(bytes.buffer).getBigUint64(0, true));
    const text = new TextDecoder().decode(bytes.subarray(8, 8 + length));
    const changed = (from, to) => {
      const header = new TextEncoder().encode(text.replace(from, to));
      const whole = new Uint8Array(8 + header.length + bytes.length - 8 - length);
      new DataView(whole.buffer).setBigUint64(0, BigInt(header.length), true);
      whole.set(header, 8);
      whole.set(bytes.subarray(8 + length), 8 + header.length);
      return whole;
    };
    return {
      untouched: await failure(make({ scene: changed("", "") }).then((r) => r.dispose())),
      extractor: await failure(make({ scene: changed(/"extractor_sha256":"[0-9a-f]{4}/, '"extractor_sha256":"0000') })),
      version: await failure(make({ scene: changed('"format":"2"', '"format":"9"') })),
      cut: await failure(make({ scene: bytes.slice(0, bytes.length - 100) })),
      empty: await failure(make({ scene: new Uint8Array(0) })),
      kind: await failure(make({ scene: "./vendor/landline/xfeat.safetensors" })),
      swapped: await failure(make({ extractor: "./scenes/sample/sample.landline" })),
      missing: await failure(make({ scene: "./nowhere.landline" })),
      checksum: await failure(make({ integrity: { scene: "0".repeat(64) }, cache: "none" })),
    };
  });
  assert.deepEqual(outcome, {
    untouched: "no error",
    extractor: "scene-extractor",
    version: "scene-version",
    cut: "scene-corrupt",
    empty: "scene-corrupt",
    kind: "scene-corrupt",
    swapped: "extractor-corrupt",
    missing: "asset-fetch",
    checksum: "asset-integrity",
  });
});

test("a damaged cache entry is loaded again", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const outcome = await page.evaluate(async () => {
    const events = [];
    const load = async () => {
      events.length = 0;
      const relocalizer = await globalThis.make({ onProgress: (event) => events.push(event) });
      await relocalizer.dispose();
      return events.filter((e) => e.status === "done" && e.file === "scene").map((e) => e.fromCache)[0];
    };
    const first = await load();
    const second = await load();
    const cache = await caches.open("landline-v1");
    const key = (await cache.keys()).find(({ url }) => url.endsWith(".landline"));
    const stored = await cache.match(key);
    const bytes = new Uint8Array(await stored.arrayBuffer());
    bytes[bytes.length - 1] ^= 1;
    await cache.put(key, new Response(bytes, { headers: stored.headers }));
    const third = await load();
    const fourth = await load();
    return [first, second, third, fourth];
  });
  assert.deepEqual(outcome, [false, true, false, true]);
});

test("200 frames do not make memory grow", { skip, timeout: 600_000 }, async (t) => {
  const { page, context } = await blank(t);
  page.setDefaultTimeout(550_000);
  const session = await context.newCDPSession(page);
  const heap = async () => {
    await session.send("HeapProfiler.collectGarbage");
    return (await session.send("Runtime.getHeapUsage")).usedSize;
  };
  await page.evaluate(async () => {
    const relocalizer = await globalThis.make({ smoothing: "steady" });
    const list = await (await fetch("./scenes/sample/sample.json")).json();
    const bitmaps = await Promise.all(list.pictures.slice(0, 4).map(async ({ name }) => createImageBitmap(await (await fetch(`./scenes/sample/${name}`)).blob(), { resizeWidth: 160, resizeHeight: 120 })));
    globalThis.run = async (frames) => {
      for (let i = 0; i < frames; i++) await relocalizer.locate(bitmaps[i % bitmaps.length], { tracking: true, include: ["points", "lines", "segments"] });
      return (await relocalizer.memory()).wasmBytes;
    };
  });
  const wasmBefore = await page.evaluate(() => globalThis.run(50));
  const heapBefore = await heap();
  const wasmAfter = await page.evaluate(() => globalThis.run(200));
  const heapAfter = await heap();
  t.diagnostic(`wasm ${wasmBefore} -> ${wasmAfter} bytes, page's heap ${heapBefore} -> ${heapAfter} bytes over 200 frames`);
  assert.equal(wasmAfter, wasmBefore);
  assert.ok(heapAfter - heapBefore < 1e6 / 3, `the page's heap grew by ${heapAfter - heapBefore} bytes`);
});
