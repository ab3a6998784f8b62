// Times XFeat in several builds of this library beside each other and beside onnxruntime-web, one thread, in turns; under Node
// by processor time, in headless Chromium by the page's clock.
//
//   node --experimental-wasm-relaxed-simd builds.mjs FOLDER NAME=NN_PEERS.wasm... [--rounds N]
//
// FOLDER is what networks.py made. The ratios are those to the first build and onnxruntime-web's to each. CHROME names the browser.
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { loadavg } from "node:os";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import * as ort from "onnxruntime-web";
import { blankPage } from "../blank_page.mjs";
import { raceXfeat } from "./race.mjs";

const [folder, ...rest] = process.argv.slice(2);
const rounds = Number(rest[rest.indexOf("--rounds") + 1]) || 30;
const builds = rest.filter((word) => word.includes("=")).map((word) => word.split("=", 2));
const load = () => loadavg()[0].toFixed(1);

function report(where, results) {
  const [first] = results;
  const peer = results.at(-1);
  for (const { name, off, best, median } of results) {
    const theirs = off === undefined ? "" : `, onnxruntime-web's ${(peer.best / best).toFixed(2)} / ${(peer.median / median).toFixed(2)} times, off by ${off.toExponential(1)}`;
    console.log(`${where} ${name}: ${best.toFixed(1)} / ${median.toFixed(1)} ms, ${(best / first.best).toFixed(2)} / ${(median / first.median).toFixed(2)} of ${first.name}${theirs}`);
  }
}

console.log(`Node ${process.versions.node}, fastest / median, load ${load()}`);
const modules = await Promise.all(builds.map(async ([name, path]) => ({ name, bytes: await readFile(path) })));
const processor = () => {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1e3;
};
const read = async (name) => new Uint8Array(await readFile(join(folder, name)));
report("Node", await raceXfeat(ort, modules, read, processor, rounds));

const here = dirname(fileURLToPath(import.meta.url));
const theirs = dirname(createRequire(import.meta.url).resolve("onnxruntime-web"));
const { page, browser, close } = await blankPage((path) => {
  const [, kind, name] = path.split("/");
  if (kind === "ort") return join(theirs, name);
  if (kind === "build") return resolve(builds[Number(name)][1]);
  return kind === "data" ? join(folder, name) : join(here, "race.mjs");
}, 600_000);
console.log(`Chromium ${browser.version()}, load ${load()}`);
const inBrowser = await page.evaluate(
  async ({ names, rounds }) => {
    const ort = await import("/ort/ort.wasm.min.mjs");
    ort.env.wasm.wasmPaths = "/ort/";
    const { raceXfeat } = await import("/race.mjs");
    const bytes = async (path) => new Uint8Array(await (await fetch(path)).arrayBuffer());
    const modules = await Promise.all(names.map(async (name, index) => ({ name, bytes: await bytes(`/build/${index}`) })));
    return raceXfeat(ort, modules, (name) => bytes(`/data/${name}`), () => performance.now(), rounds);
  },
  { names: builds.map(([name]) => name), rounds },
);
await close();
report("Chromium", inBrowser);
