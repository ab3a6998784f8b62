// A film through `landline/mapper` under Node, on one thread: seconds and memory from the last frame to the scene.
//
//   node benches/map_node.mjs PACKAGE FOLDER WIDTH HEIGHT [STEP] [FIRST] [END] > out.json
//
// PACKAGE is dist/npm/landline, FOLDER has frames as NUMBER.rgb (rows of 8-bit RGB; six digits). Frames FIRST, FIRST + STEP, ..
// before END are the film; the hundred from END on are located in the scene. What was placed and found goes to standard output,
// `cameraFromWorld` row-major, to be held against poses that are known; figures go to standard error.
import { readFile } from "node:fs/promises";
import { resolve } from "node:path";

const [packageFolder, folder, width, height, step = 7, first = 0, end = 800] = process.argv.slice(2).map((text, i) => (i < 2 ? resolve(text) : Number(text)));
const { Mapper } = await import(`${packageFolder}/mapper/index.js`);
const { Relocalizer } = await import(`${packageFolder}/index.js`);
const frame = async (i) => ({ data: new Uint8Array(await readFile(`${folder}/${String(i).padStart(6, "0")}.rgb`)), width, height, format: "rgb8" });
const seconds = (from) => ((performance.now() - from) / 1000).toFixed(1);
const processor = () => (process.cpuUsage().user + process.cpuUsage().system) / 1e6;

const mapper = await Mapper.create();
const filming = performance.now();
for (let i = first; i < end; i += step) await mapper.addFrame(await frame(i), { name: String(i) });
console.error(`film ${seconds(filming)} s`, mapper.coverage);

const [building, before] = [performance.now(), processor()];
const stages = {};
let [last, longest] = [building, 0];
const onProgress = ({ stage }) => {
  const now = performance.now();
  stages[stage] = (stages[stage] ?? 0) + (now - last) / 1000;
  longest = Math.max(longest, now - last);
  last = now;
};
const { scene, report } = await mapper.build({ onProgress });
console.error(`build ${seconds(building)} s, ${(processor() - before).toFixed(1)} s of processor, longest step ${(longest / 1000).toFixed(1)} s`, stages, await mapper.memory());
const { pictures, cloud, ...rest } = report;
console.error(rest, `${scene.length} bytes, process ${Math.round(process.resourceUsage().maxRSS / 1024)} MB`);
await mapper.dispose();

const relocalizer = await Relocalizer.create({ scene, device: "cpu" });
const found = [];
for (let i = end; i < end + 100; i++) {
  const { placement } = await relocalizer.locate(await frame(i));
  found.push({ name: String(i), pose: placement && [...placement.cameraFromWorld] });
}
await relocalizer.dispose();
const placed = pictures.map(({ name, placement }) => ({ name, pose: placement && [...placement.cameraFromWorld] }));
console.log(JSON.stringify({ placed, found }));
