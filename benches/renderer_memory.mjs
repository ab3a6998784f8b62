// What the browser's process of a page holds after relocalizers that were made, used for a frame and given up.
//
//   CHROME=/usr/bin/chromium node benches/renderer_memory.mjs [MANY] [site]      # on a site that is built: cargo xtask web
//
// Each row has a fresh browser. Memory is the process's own (RssAnon), after forced collections. `streams` makes nothing: it only reads
// the scene and the extractor as streams, `network` does so while DevTools records the network, as Playwright has it.
import { existsSync } from "node:fs";
import { join, normalize } from "node:path";
import { renderersMb, root, unwatchedPage } from "./blank_page.mjs";

const [many = "60", site = join(root, "dist/site")] = process.argv.slice(2);
if (!(Number(many) >= 20) || !existsSync(join(site, "vendor/landline/index.js"))) throw new Error("usage: node benches/renderer_memory.mjs [MANY, 20 or more] [SITE]; the site is made by `cargo xtask web`");
const flags = ["--disable-gpu", "--enable-unsafe-swiftshader", "--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader", "--js-flags=--expose-gc"];

async function make({ count, options }) {
  const { Relocalizer } = await import("/vendor/landline/index.js");
  const data = new Uint8ClampedArray(160 * 120 * 4);
  for (let i = 0; i < data.length; i++) data[i] = i % 4 === 3 ? 255 : (Math.imul(i, 2654435761) >>> 24) & 255;
  for (let i = 0; i < count; i++) {
    const relocalizer = await Relocalizer.create({ scene: "/scenes/sample/sample.landline", maxSide: 256, ...options });
    await relocalizer.locate({ data, width: 160, height: 120 });
    await relocalizer.dispose();
  }
}
async function stream({ count }) {
  for (let i = 0; i < count; i++) {
    for (const address of ["/scenes/sample/sample.landline", "/vendor/landline/xfeat.safetensors"]) {
      const reader = (await fetch(address)).body.getReader();
      while (!(await reader.read()).done);
    }
  }
}
const rows = {
  "worker, CPU": { run: make, options: { device: "cpu", worker: true } },
  "no worker, CPU": { run: make, options: { device: "cpu", worker: false } },
  "worker, WebGPU": { run: make, options: { device: "webgpu", worker: true } },
  "no worker, WebGPU": { run: make, options: { device: "webgpu", worker: false } },
  streams: { run: stream },
  network: { run: stream, record: true },
};

const tenth = 10;
console.log("| row | MB at first | after 20 | after all | MB each, after 20 | workers left |\n| --- | --- | --- | --- | --- | --- |");
for (const [name, { run, options, record }] of Object.entries(rows)) {
  const { evaluate, send, workers, close } = await unwatchedPage((path) => join(site, normalize(path)), flags);
  if (record) await send("Network.enable");
  const held = async () => {
    for (let i = 0; i < 2; i++) {
      await evaluate(() => globalThis.gc());
      await new Promise((done) => setTimeout(done, 500));
    }
    return renderersMb();
  };
  const start = await held();
  let early = NaN;
  for (let made = tenth; made <= Number(many); made += tenth) {
    await evaluate(run, { count: tenth, options });
    if (made === 20) early = await held();
  }
  const end = await held();
  const each = (end - early) / Math.max(1, Math.floor(Number(many) / tenth) * tenth - 20);
  console.log(`| ${name} | ${start.toFixed(1)} | ${early.toFixed(1)} | ${end.toFixed(1)} | ${each.toFixed(2)} | ${workers.size} |`);
  await close();
}
