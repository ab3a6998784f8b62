// Time of a frame by stage, CPU back end, one thread, in headless Chromium and under Node on the same pixels.
//
//   cargo xtask web
//   node benches/frame_times.mjs SCENE PICTURES_FOLDER FIRST-LAST FOCAL [rounds]
//
// Pictures are taken by their place in the sorted folder. The builds of the engine take turns frame by frame, and with
// OTHER=FOLDER (`dist/site` of another commit) that one's as well, with the same scene or, where it cannot read it, with
// OTHER_SCENE; SITE=FOLDER stands for this commit's.
// Prints medians over all frames after five warm-up frames ("look" is the second look, for scenes with landmarks), and each
// build's share of the last one's time; under Node also the processor time of a frame, which other programs lengthen less.
// Node 20 needs --experimental-wasm-relaxed-simd for the relaxed build. CHROME names the browser.
import { readFile, readdir } from "node:fs/promises";
import { loadavg } from "node:os";
import { join, normalize } from "node:path";
import { pathToFileURL } from "node:url";
import { blankPage, root } from "./blank_page.mjs";

const [sceneFile, folder, range, focal, rounds = "1"] = process.argv.slice(2);
if (!focal) throw new Error("usage: node benches/frame_times.mjs SCENE PICTURES_FOLDER FIRST-LAST FOCAL [rounds]");
const [first, last] = range.split("-").map(Number);
const names = (await readdir(folder)).filter((name) => /\.(jpe?g|png)$/.test(name)).sort().slice(first, last + 1);
const warmUp = 5;
const stages = ["transfer", "preprocess", "features", "lines", "regress", "solve"];

const site = process.env.SITE ?? join(root, "dist/site");
const other = process.env.OTHER;
const variants = ["plain", "relaxed", ...(other ? ["other"] : [])];
const engine = "vendor/landline/index.js";
const { page, browser, close } = await blankPage((path) => {
  if (path === "/scene") return sceneFile;
  if (path === "/other-scene") return process.env.OTHER_SCENE ?? sceneFile;
  if (path.startsWith("/pictures/")) return join(folder, normalize(path.slice(10)));
  return other && path.startsWith("/other/") ? join(other, normalize(path.slice(7))) : join(site, normalize(path));
}, 600_000);
console.log(`Chromium ${browser.version()}, Node ${process.versions.node}, ${names.length} pictures, ${rounds} rounds, load ${loadavg()[0].toFixed(1)}`);

await page.evaluate(
  async ({ variants, engine }) => {
    globalThis.relocalizers = {};
    for (const variant of variants) {
      const { Relocalizer } = await import(variant === "other" ? `/other/${engine}` : `/${engine}`);
      globalThis.relocalizers[variant] = await Relocalizer.create({ device: "cpu", ...(variant === "other" ? { scene: "/other-scene" } : { scene: "/scene", build: variant }) });
    }
    globalThis.decode = async (name) => createImageBitmap(await (await fetch(`/pictures/${name}`)).blob(), { colorSpaceConversion: "none" });
  },
  { variants, engine },
);
const run = (variant, name, f) =>
  page.evaluate(
    async ({ variant, name, f }) => {
      const bitmap = await globalThis.decode(name);
      const { width, height } = bitmap;
      const { located, timingsMs } = await globalThis.relocalizers[variant].locate(bitmap, { intrinsics: { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height }, transfer: true });
      return { located, ...timingsMs };
    },
    { variant, name, f },
  );
const inTurns = async (variants, names, locate) => {
  const rows = Object.fromEntries(variants.map((variant) => [variant, []]));
  for (let round = 0; round < Number(rounds); round++) for (const name of names) for (const variant of variants) rows[variant].push(await locate(variant, name));
  return rows;
};
const inBrowser = await inTurns(variants, names, (variant, name) => run(variant, name, Number(focal)));
/** Decoded pixels, for Node. */
const decoded = [];
for (const name of names) {
  decoded.push(
    await page.evaluate(async (name) => {
      const bitmap = await globalThis.decode(name);
      const context = new OffscreenCanvas(bitmap.width, bitmap.height).getContext("2d");
      context.drawImage(bitmap, 0, 0);
      const { data, width, height } = context.getImageData(0, 0, bitmap.width, bitmap.height);
      let text = "";
      for (let i = 0; i < data.length; i += 32768) text += String.fromCharCode(...data.subarray(i, i + 32768));
      return { data: btoa(text), width, height, format: "rgba8" };
    }, name),
  );
}
await close();

const scenes = { other: process.env.OTHER_SCENE ?? sceneFile };
const { checkSupport } = await import(pathToFileURL(join(site, engine)));
const { wasmRelaxedSimd } = await checkSupport();
const relocalizers = {};
for (const variant of variants.filter((variant) => variant !== "relaxed" || wasmRelaxedSimd)) {
  const { Relocalizer } = await import(pathToFileURL(join(variant === "other" ? other : site, engine)));
  relocalizers[variant] = await Relocalizer.create({ scene: new Uint8Array(await readFile(scenes[variant] ?? sceneFile)), device: "cpu", ...(variant === "other" ? {} : { build: variant }) });
}
const underNode = await inTurns(Object.keys(relocalizers), decoded, async (variant, { data, ...frame }) => {
  const { width, height } = frame;
  const f = Number(focal);
  const pixels = new Uint8Array(Buffer.from(data, "base64"));
  const before = process.cpuUsage();
  const { located, timingsMs } = await relocalizers[variant].locate({ ...frame, data: pixels }, { intrinsics: { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height } });
  const { user, system } = process.cpuUsage(before);
  return { located, ...timingsMs, processor: (user + system) / 1000 };
});
for (const relocalizer of Object.values(relocalizers)) await relocalizer.dispose();

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
const number = (value) => (value === undefined ? "" : value.toFixed(1)).padStart(10);
console.log(["where".padEnd(17), "frames", "located", ...[...stages, "look", "total", "fastest", "slowest", "processor"].map((title) => title.padStart(10))].join(" "));
for (const [where, builds] of Object.entries({ Chromium: inBrowser, Node: underNode })) {
  const totals = {};
  for (const [variant, all] of Object.entries(builds)) {
    const rows = all.slice(warmUp);
    const of = (f) => median(rows.map(f));
    const look = of((row) => row.total - stages.reduce((sum, stage) => sum + row[stage], 0));
    const [fastest, slowest] = [Math.min, Math.max].map((f) => f(...rows.map((row) => row.total)));
    const total = of((row) => row.total);
    const processor = rows[0].processor && of((row) => row.processor);
    totals[variant] = { median: total, fastest, processor };
    const located = rows.filter((row) => row.located).length;
    console.log([`${where} ${variant}`.padEnd(17), String(rows.length).padStart(6), String(located).padStart(7), ...stages.map((stage) => number(of((row) => row[stage]))), ...[look, total, fastest, slowest, processor].map(number)].join(" "));
  }
  const names = Object.keys(totals);
  const base = totals[names.at(-1)];
  for (const name of names.slice(0, -1)) {
    const shares = Object.entries(base).filter(([, value]) => value).map(([what, value]) => `${what} ${(totals[name][what] / value).toFixed(2)}`);
    console.log(`${where} ${name} of ${names.at(-1)}: ${shares.join(", ")}`);
  }
}
