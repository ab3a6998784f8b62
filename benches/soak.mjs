// Hours of use in minutes: frames in headless Chromium, with events that a page throws at the package, in an order that a seed makes.
//
//   cargo xtask soak --frames 10000 [--seed 1]
//   node benches/soak.mjs 10000 [seed] [site]      # on a site that is built
//
// Small frames of the sample room go through `locate` and `follow`. Between them: options, reset, abort, bursts, dispose and create,
// aborted and broken creates, another scene, other sizes down to 16x16, a tab that hides, and on the software adapter of WebGPU a
// device that is lost. Printed are memory, workers and rejections along the way; a rejection that its event does not explain, an
// unhandled one, a pose that is not finite or another answer to the first picture than the first time ends the run with a failure.
// CHROME names the browser.
import { existsSync, readFileSync } from "node:fs";
import { join, normalize } from "node:path";
import { renderersMb, root, unwatchedPage } from "./blank_page.mjs";

const [frames = "10000", seed = "1", site = join(root, "dist/site")] = process.argv.slice(2);
const numFrames = Number(frames);
if (!(numFrames > 0) || !existsSync(join(site, "vendor/landline/index.js"))) throw new Error("usage: node benches/soak.mjs FRAMES [SEED] [SITE]; the site is made by `cargo xtask web`");

const sample = join(site, "scenes/sample/sample.landline");
const find = (path) => {
  if (path === "/broken.landline") return readFileSync(sample).subarray(0, 5000);
  return join(site, normalize(path));
};
const flags = ["--disable-gpu", "--enable-unsafe-swiftshader", "--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--js-flags=--expose-gc"];
const { evaluate, send, workers, errors: unhandled, product, close } = await unwatchedPage(find, flags);
await send("Performance.enable");

await evaluate(async (seed) => {
  const { Relocalizer, follow } = await import("/vendor/landline/index.js");
  const sample = await (await fetch("/scenes/sample/sample.json")).json();
  const pictures = [];
  for (const { name } of sample.pictures) pictures.push(await createImageBitmap(await (await fetch(`/scenes/sample/${name}`)).blob()));
  // mulberry32
  let state = seed >>> 0;
  const random = () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), state | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
  const below = (n) => Math.floor(random() * n);
  const pick = (list) => list[below(list.length)];

  const tally = (globalThis.tally = { frames: 0, located: 0, made: 0, lostDevices: 0, events: {}, rejected: {}, unexplained: [], notFinite: 0, differing: 0, wasm: 0 });
  globalThis.addEventListener("unhandledrejection", (event) => tally.unexplained.push(`unhandled: ${event.reason}`));
  /** The devices that the package asked for on this thread, to lose one. */
  const devices = [];
  if (globalThis.GPUAdapter) {
    const ask = GPUAdapter.prototype.requestDevice;
    GPUAdapter.prototype.requestDevice = async function (...words) {
      const device = await ask.apply(this, words);
      devices.push(device);
      return device;
    };
  }
  let isHidden = false;
  Object.defineProperty(document, "hidden", { get: () => isHidden });
  Object.defineProperty(document, "visibilityState", { get: () => (isHidden ? "hidden" : "visible") });

  /** Waits; a rejection is counted by its code, and kept where the event does not explain it. */
  const expect = async (promise, ...codes) => {
    try {
      return await promise;
    } catch (error) {
      const code = typeof error?.code === "string" ? error.code : (error?.name ?? String(error));
      tally.rejected[code] = (tally.rejected[code] ?? 0) + 1;
      if (!codes.includes(code)) tally.unexplained.push(`${code}: ${error?.message ?? error}`);
      return undefined;
    }
  };
  const canvas = document.createElement("canvas");
  const paint = (longer) => {
    const bitmap = pick(pictures);
    const scale = longer / Math.max(bitmap.width, bitmap.height);
    canvas.width = Math.max(16, Math.round(bitmap.width * scale));
    canvas.height = Math.max(16, Math.round(bitmap.height * scale));
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
    return context;
  };
  let longer = 128;
  const frame = () => {
    const context = paint(longer);
    return context.getImageData(0, 0, canvas.width, canvas.height);
  };
  /** The sample's camera, for a frame of another size. */
  const seen = (image, more = {}) => {
    const { width, height, fx, fy, cx, cy } = sample.camera;
    const [x, y] = [image.width / width, image.height / height];
    return { intrinsics: { fx: fx * x, fy: fy * y, cx: cx * x, cy: cy * y, width: image.width, height: image.height }, ...more };
  };
  const locate = (more, ...codes) => {
    const image = frame();
    // Below 32 pixels a frame is refused.
    const small = Math.min(image.width, image.height) < 32 ? ["bad-input"] : [];
    return expect(relocalizer.locate(image, random() < 0.9 ? seen(image, more) : more), ...codes, ...small);
  };
  const count = (result) => {
    tally.frames += 1;
    if (!result?.located) return;
    tally.located += 1;
    if (!result.placement.cameraFromWorld.every(Number.isFinite)) tally.notFinite += 1;
  };

  let relocalizer;
  let reference;
  const scenes = ["/scenes/sample/sample.landline", "/scenes/sample/sample.landline?second"];
  const make = async (more = {}, ...codes) => {
    const made = await expect(Relocalizer.create({ scene: pick(scenes), device: "cpu", maxSide: 256, worker: random() < 0.8, ...more }), ...codes);
    if (made) tally.made += 1;
    return made;
  };
  /** One picture, the first frame of a relocalizer on the CPU: the same bits each time. */
  const first = async () => {
    const bitmap = pictures[0];
    canvas.width = 128;
    canvas.height = Math.round((bitmap.height * 128) / bitmap.width);
    const context = canvas.getContext("2d", { willReadFrequently: true });
    context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
    const image = context.getImageData(0, 0, canvas.width, canvas.height);
    const result = await expect(relocalizer.locate(image, seen(image)));
    count(result);
    const answer = JSON.stringify(result?.located ? Array.from(result.placement.cameraFromWorld) : (result?.reason ?? null));
    reference ??= answer;
    if (answer !== reference) tally.differing += 1;
  };
  const renew = async (more) => {
    await relocalizer?.dispose();
    relocalizer = await make({ scene: scenes[0], ...more });
    if (!relocalizer) throw new Error(`no relocalizer: ${tally.unexplained.at(-1)}`);
  };

  const events = {
    async frames() {
      for (let i = 0; i < 10; i++) count(await locate({ tracking: random() < 0.3 }));
    },
    async burst() {
      const asked = Array.from({ length: 2 + below(6) }, () => locate(random() < 0.2 ? { camera: `c${below(3)}` } : {}));
      for (const result of await Promise.all(asked)) count(result);
    },
    async options() {
      await expect(relocalizer.setOptions({ smoothing: pick(["off", "steady", "responsive"]), maxSide: pick([64, 128, 256, 320]), timeBudgetMs: pick([1, 20, 200]), seed: below(1000), maxPointErrorPx: 1 + 20 * random() }));
    },
    async nonsense() {
      const wrong = pick([{ maxSide: NaN }, { maxSide: 1e9 }, { timeBudgetMs: -1 }, { nobody: 1 }, { seed: 5n }]);
      await expect(relocalizer.setOptions(wrong), "bad-input");
      await expect(relocalizer.locate(frame(), pick([{ include: "points" }, { camera: 5 }, { timestamp: 12n }])), "bad-input");
    },
    async reset() {
      await expect(relocalizer.reset());
    },
    async abort() {
      const stop = new AbortController();
      const asked = locate({ signal: stop.signal }, "AbortError");
      if (random() < 0.5) await null;
      stop.abort();
      await asked;
      tally.frames += 1;
    },
    async size() {
      longer = pick([16, 33, 64, 128, 128, 256, 256]);
    },
    async dispose() {
      // Frames under way reject.
      const asked = Array.from({ length: below(3) }, () => locate({}, "disposed"));
      await renew({ worker: random() < 0.8 });
      await Promise.all(asked);
      await first();
    },
    async scene() {
      await renew({ scene: scenes[1] });
    },
    async abortedCreate() {
      const stop = new AbortController();
      setTimeout(() => stop.abort(), 40 * random());
      const made = await make({ signal: stop.signal }, "AbortError");
      await made?.dispose();
    },
    async brokenCreate() {
      await make({ scene: "/broken.landline" }, "scene-corrupt");
    },
    async followed() {
      const context = paint(128);
      const video = document.createElement("video");
      video.muted = true;
      video.srcObject = canvas.captureStream(30);
      const painter = setInterval(() => {
        if (random() < 0.1) paint(pick([64, 128]));
        else context.drawImage(canvas, 0, 0);
      }, 33);
      await expect(video.play());
      const loop = follow(relocalizer, video, { onResult: count });
      loop.addEventListener("error", (event) => tally.unexplained.push(`follow: ${event.detail?.code ?? event.detail}`));
      await new Promise((done) => setTimeout(done, 400 + 800 * random()));
      if (random() < 0.5) {
        isHidden = true;
        document.dispatchEvent(new Event("visibilitychange"));
        await new Promise((done) => setTimeout(done, 200));
        isHidden = false;
        document.dispatchEvent(new Event("visibilitychange"));
        await new Promise((done) => setTimeout(done, 200));
      }
      loop.stop();
      clearInterval(painter);
      for (const track of video.srcObject.getTracks()) track.stop();
      video.srcObject = null;
    },
    async lostDevice() {
      // On this thread, where the device can be had.
      await renew({ device: "auto", worker: false, maxSide: 64 });
      longer = 64;
      count(await locate({}));
      const device = devices.pop();
      if (device) {
        const asked = random() < 0.5 ? locate({}) : undefined;
        device.destroy();
        tally.lostDevices += 1;
        if (asked) count(await asked);
      }
      devices.length = 0;
      count(await locate({}));
      await renew();
      longer = 128;
    },
  };
  const weights = { frames: 60, burst: 12, options: 10, nonsense: 4, reset: 6, abort: 6, size: 6, dispose: 3, scene: 1, abortedCreate: 2, brokenCreate: 1, followed: 3, lostDevice: 0.3 };
  const total = Object.values(weights).reduce((sum, weight) => sum + weight, 0);
  await renew();
  await first();
  globalThis.soak = async (until) => {
    while (tally.frames < until) {
      let at = random() * total;
      const name = Object.keys(weights).find((key) => (at -= weights[key]) < 0) ?? "frames";
      tally.events[name] = (tally.events[name] ?? 0) + 1;
      await events[name]();
    }
    tally.wasm = (await expect(relocalizer.memory())).wasmBytes;
    globalThis.gc?.();
    return tally;
  };
  globalThis.end = () => relocalizer.dispose();
}, Number(seed));

console.log(`${product}, ${numFrames} frames, seed ${seed}`);
const header = ["frames", "seconds", "events", "made", "devices lost", "located", "heap MB", "wasm MB", "renderer MB", "workers", "rejections", "unexplained"];
console.log(`| ${header.join(" | ")} |\n|${" --- |".repeat(header.length)}`);
const start = performance.now();
let tally;
let told = 0;
const steps = Math.min(20, Math.max(1, Math.floor(numFrames / 100)));
for (let i = 1; i <= steps; i++) {
  tally = await evaluate((until) => globalThis.soak(until), Math.round((numFrames * i) / steps));
  const { metrics } = await send("Performance.getMetrics");
  const heap = metrics.find(({ name }) => name === "JSHeapUsedSize").value / 2 ** 20;
  const sum = (counts) => Object.values(counts).reduce((all, n) => all + n, 0);
  const row = [tally.frames, ((performance.now() - start) / 1000).toFixed(0), sum(tally.events), tally.made, tally.lostDevices, tally.located, heap.toFixed(1), (tally.wasm / 2 ** 20).toFixed(1), renderersMb().toFixed(0), workers.size, sum(tally.rejected), tally.unexplained.length + unhandled.length];
  console.log(`| ${row.join(" | ")} |`);
  const known = [...tally.unexplained, ...unhandled];
  for (const fault of known.slice(told, told + 20)) console.error(`unexplained: ${fault}`);
  told = known.length;
}
await evaluate(() => globalThis.end());
await new Promise((done) => setTimeout(done, 500));
console.log(`events ${JSON.stringify(tally.events)}`);
console.log(`rejections ${JSON.stringify(tally.rejected)}`);
console.log(`poses not finite ${tally.notFinite}, first answers that differ ${tally.differing}, workers left ${workers.size}`);
const faults = [...tally.unexplained, ...unhandled];
const left = workers.size;
await close();
if (faults.length > 0 || tally.notFinite > 0 || tally.differing > 0 || left > 0) process.exitCode = 1;
