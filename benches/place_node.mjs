// A place of many rooms through `landline/place` under Node: rooms told apart, seconds and memory over thousands of frames.
//
//   node benches/place_node.mjs PACKAGE MANIFEST FOLDER WIDTH HEIGHT FOCAL [FRAMES [STAY]]
//
// PACKAGE is dist/npm/landline, MANIFEST a `.place.json` beside its scenes; FOLDER has ROOM.rgb for each room that is asked for:
// pictures one after another, rows of 8-bit RGB (`ffmpeg -i %03d.jpg -f rawvideo -pix_fmt rgb24 ROOM.rgb`). FRAMES frames go
// through the rooms in the order of their names, STAY in each before the next. For one room a relocalizer with that scene alone
// answers the same frames in turns.
import { open, readdir } from "node:fs/promises";
import { dirname, join, resolve } from "node:path";

const [packageFolder, manifestFile, folder, ...numbers] = process.argv.slice(2);
if (numbers.length < 3) throw new Error("usage: node benches/place_node.mjs PACKAGE MANIFEST FOLDER WIDTH HEIGHT FOCAL [FRAMES [STAY]]");
const [width, height, focal, frames = 1000, stay = 20] = numbers.map(Number);
const { Place } = await import(`${resolve(packageFolder)}/place/index.js`);
const { Relocalizer } = await import(`${resolve(packageFolder)}/index.js`);
const intrinsics = { fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height };
const bytes = width * height * 3;
const median = (values) => [...values].sort((a, b) => a - b)[values.length >> 1];

const rooms = [];
for (const name of (await readdir(folder)).filter((name) => name.endsWith(".rgb")).sort()) {
  const file = await open(join(folder, name));
  rooms.push({ id: name.slice(0, -4), file, count: Math.floor((await file.stat()).size / bytes) });
}
async function frameOf({ file, count }, i) {
  const data = new Uint8Array(bytes);
  await file.read(data, 0, bytes, (i % count) * bytes);
  return { data, width, height, format: "rgb8" };
}
const timed = async (call) => {
  const before = performance.now();
  const answer = await call();
  return { answer, ms: performance.now() - before };
};

const place = await Place.create({ place: resolve(manifestFile) });
const tally = { right: 0, wrong: 0, rivals: 0, nothing: 0 };
const [entering, staying, alone] = [[], [], []];
let first;
let single;
for (let k = 0; k < frames; k++) {
  const visit = Math.floor(k / stay);
  const room = rooms[visit % rooms.length];
  const at = (Math.floor(visit / rooms.length) * stay + k) % room.count;
  const { answer, ms } = await timed(async () => place.locate(await frameOf(room, at), { intrinsics, tracking: true }));
  first ??= ms;
  (k % stay === 0 ? entering : staying).push(ms);
  tally[answer.located ? (answer.room.id === room.id ? "right" : "wrong") : answer.rivals ? "rivals" : "nothing"] += 1;
  if (answer.located && answer.room.id !== room.id) console.log(`${room.id} ${at} taken for ${answer.room.id}, confidence ${answer.quality.confidence.toFixed(3)}`);
  if (visit === 0) {
    single ??= await Relocalizer.create({ scene: join(dirname(resolve(manifestFile)), `${room.id}.landline`), device: "cpu" });
    alone.push((await timed(async () => single.locate(await frameOf(room, at), { intrinsics, tracking: true }))).ms);
  }
  if ((k + 1) % 500 === 0 || k + 1 === frames) {
    const { wasmBytes, sceneBytes } = await place.memory();
    const mb = (n) => (n / 2 ** 20).toFixed(1);
    console.log(`${k + 1} frames: ${JSON.stringify(tally)}; engine ${mb(wasmBytes)} MiB, scenes ${mb(sceneBytes)}, process ${mb(process.memoryUsage().rss)}; entering ${median(entering).toFixed(0)} ms, staying ${median(staying).toFixed(0)}`);
  }
}
const own = staying.slice(0, alone.length - 1);
console.log(`first frame ${first.toFixed(0)} ms; in a known room ${median(own).toFixed(1)} ms, with its scene alone ${median(alone.slice(1)).toFixed(1)}: ${(median(own) / median(alone.slice(1))).toFixed(3)}`);
await place.dispose();
await single?.dispose();
for (const { file } of rooms) await file.close();
