// The tracker in wasm under Node, one thread: processor time of each frame of a video between two answers of the relocalizer.
//
//     ffmpeg -i VIDEO -f rawvideo -pix_fmt rgba frames.rgba
//     node benches/track_times.mjs dist/npm/landline SCENE.landline frames.rgba 640 480 [FOCAL_PX] [FRAMES_BETWEEN]
//
// Every so many frames one is located and becomes the reference; the times of those are left out. Other jobs on the machine do not
// count, but for what they do to caches.
import { open, readFile } from "node:fs/promises";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [folder, scene, video, width, height, focal = "0", between = "10"] = process.argv.slice(2);
const [w, h, f] = [width, height, focal].map(Number);
const { Relocalizer } = await import(pathToFileURL(join(resolve(folder), "index.js")));
const relocalizer = await Relocalizer.create({ scene: await readFile(scene), device: "cpu", worker: false });
const follower = await relocalizer.follower();
const file = await open(video);
const data = new Uint8Array(4 * w * h);
const intrinsics = f > 0 ? { intrinsics: { fx: f, fy: f, cx: w / 2, cy: h / 2, width: w, height: h } } : {};
const [times, answers] = [[], []];
let [frames, located] = [0, 0];
const spent = (before) => {
  const { user, system } = process.cpuUsage(before);
  return (user + system) / 1000;
};
for (; (await file.read(data, 0, data.length, data.length * frames)).bytesRead === data.length; frames++) {
  let before = process.cpuUsage();
  const result = follower.track({ data, width: w, height: h }, (1000 / 30) * frames);
  if (result.located) located += 1;
  // The first frames are compiled while they run.
  if (result.located && frames > 20) times.push(spent(before));
  if (frames % Number(between)) continue;
  follower.hold(result.index);
  const answer = await relocalizer.locate({ data: data.slice(), width: w, height: h, format: "rgba8" }, { include: ["points", "lines"], ...intrinsics });
  before = process.cpuUsage();
  const use = follower.localized(result.index, answer);
  if (use === "followed") answers.push(spent(before));
}
const at = (values, q) => [...values].sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))]?.toFixed(2);
console.log(`${frames} frames of ${w}x${h}, ${located} with a position, ${answers.length} answers followed`);
console.log(`a frame: ${at(times, 0.5)} ms (median), ${at(times, 0.99)} ms (99 %) over ${times.length}; an answer: ${at(answers, 0.5)} ms (median), ${at(answers, 1)} ms (most)`);
await file.close();
follower.dispose();
await relocalizer.dispose();
