// A film through `landline/mapper` under Node, on one thread: seconds and memory from the last frame to the scene.
//
//   node benches/map_node.mjs PACKAGE FOLDER WIDTH HEIGHT [STEP] [FIRST] [END] > out.json
//
// PACKAGE is dist/npm/landline, FOLDER has frames as NUMBER.rgb (rows of 8-bit RGB; six digits). Frames FIRST, FIRST + STEP, ..
// before END are the film; the hundred from END on are located in the scene. What was placed and found goes to standard output,
// `cameraFromWorld` row-major, for map_check.py to hold against poses that are known; figures go to standard error.
import { readFile } from "node:fs/promises";
import { resolve } from "node:path";
import { mapFilm, range } from "./map_film.mjs";

const [packageFolder, folder, width, height, step = 7, first = 0, end = 800] = process.argv.slice(2).map((text, i) => (i < 2 ? resolve(text) : Number(text)));
const { Mapper } = await import(`${packageFolder}/mapper/index.js`);
const { Relocalizer } = await import(`${packageFolder}/index.js`);

const result = await mapFilm({
  Mapper,
  Relocalizer,
  frame: async (i) => ({ data: new Uint8Array(await readFile(`${folder}/${String(i).padStart(6, "0")}.rgb`)), width, height, format: "rgb8" }),
  film: range(first, end, step),
  test: range(end, end + 100),
  clock: () => (process.cpuUsage().user + process.cpuUsage().system) / 1e6,
  say: console.error,
});
console.error(`process ${Math.round(process.resourceUsage().maxRSS / 1024)} MB`);
console.log(JSON.stringify(result));
