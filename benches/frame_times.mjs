// Time of a frame by stage, CPU back end, one thread, in headless Chromium and under Node on the same pixels.
//
//   cargo xtask web
//   node benches/frame_times.mjs SCENE PICTURES_FOLDER FIRST-LAST FOCAL [rounds]
//
// Pictures are taken by their place in the sorted folder. Prints medians over all frames after five warm-up frames, and
// the whole of the slowest frame, and the processor time of a frame under Node, which other programs do not lengthen.
// CHROME names the browser.
import { readFile, readdir } from "node:fs/promises";
import { join, normalize } from "node:path";
import { pathToFileURL } from "node:url";
import { blankPage, root } from "./blank_page.mjs";

const [sceneFile, folder, range, focal, rounds = "1"] = process.argv.slice(2);
if (!focal) throw new Error("usage: node benches/frame_times.mjs SCENE PICTURES_FOLDER FIRST-LAST FOCAL [rounds]");
const [first, last] = range.split("-").map(Number);
const names = (await readdir(folder)).filter((name) => /\.(jpe?g|png)$/.test(name)).sort().slice(first, last + 1);
const warmUp = 5;
const stages = ["transfer", "preprocess", "features", "lines", "regress", "solve", "total"];

const site = join(root, "dist/site");
const { page, browser, close } = await blankPage((path) => {
  if (path === "/scene") return sceneFile;
  return path.startsWith("/pictures/") ? join(folder, normalize(path.slice(10))) : join(site, normalize(path));
}, 600_000);
console.log(`Chromium ${browser.version()}, Node ${process.versions.node}, ${names.length} pictures, ${rounds} rounds`);

/** Decoded pixels, for Node. */
const decoded = [];
const inBrowser = [];
await page.evaluate(async () => {
  const { Relocalizer } = await import("/vendor/landline/index.js");
  globalThis.relocalizer = await Relocalizer.create({ scene: "/scene", device: "cpu" });
  globalThis.decode = async (name) => createImageBitmap(await (await fetch(`/pictures/${name}`)).blob(), { colorSpaceConversion: "none" });
});
const run = (name, f) =>
  page.evaluate(
    async ({ name, f }) => {
      const bitmap = await globalThis.decode(name);
      const { width, height } = bitmap;
      const { located, timingsMs } = await globalThis.relocalizer.locate(bitmap, { intrinsics: { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height }, transfer: true });
      return { located, ...timingsMs };
    },
    { name, f },
  );
for (let round = 0; round < Number(rounds); round++) for (const name of names) inBrowser.push(await run(name, Number(focal)));
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

const { Relocalizer } = await import(pathToFileURL(join(root, "dist/npm/landline/index.js")));
const relocalizer = await Relocalizer.create({ scene: new Uint8Array(await readFile(sceneFile)), device: "cpu" });
const underNode = [];
// Node compiles in the first round; what other programs take does not count in processor time.
let used = process.cpuUsage();
for (let round = 0; round < Number(rounds); round++) {
  for (const { data, ...frame } of decoded) {
    const { width, height } = frame;
    const f = Number(focal);
    const { located, timingsMs } = await relocalizer.locate({ ...frame, data: new Uint8Array(Buffer.from(data, "base64")) }, { intrinsics: { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height } });
    underNode.push({ located, ...timingsMs });
    if (underNode.length === warmUp) used = process.cpuUsage();
  }
}
used = process.cpuUsage(used);
await relocalizer.dispose();

const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];
console.log(["where".padEnd(9), "frames", ...stages.map((stage) => stage.padStart(10)), "slowest".padStart(10)].join(" "));
for (const [where, rows] of Object.entries({ Chromium: inBrowser, Node: underNode })) {
  const counted = rows.slice(warmUp);
  console.log([where.padEnd(9), String(counted.length).padStart(6), ...stages.map((stage) => median(counted.map((row) => row[stage])).toFixed(1).padStart(10)), Math.max(...counted.map(({ total }) => total)).toFixed(1).padStart(10)].join(" "));
}
console.log(`Node: ${((used.user + used.system) / 1000 / (underNode.length - warmUp)).toFixed(1)} ms of processor time a frame`);
