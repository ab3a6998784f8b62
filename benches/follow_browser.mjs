// `follow` over a playing video in headless Chromium, with and without tracking: what stands on the screen at every frame.
//
//   node benches/follow_browser.mjs PACKAGE SCENE PICTURES POSES FOCAL [PREFIX] [FIRST] [END] [PASSES] [FPS]
//
// PACKAGE is dist/npm/landline, PICTURES a folder of JPEG or PNG files of one size, taken by their place in the sorted list of
// those whose names begin with PREFIX, from FIRST to before END. POSES, a list of `NAME QW QX QY QZ TX TY TZ` (camera from world), has their true poses in the scene's world,
// FOCAL is their focal length in pixels. They are painted on a canvas FPS times a second, there and back PASSES times in all, and its stream is the
// video; a frame's number stands in its lower left corner in black and white. Overlay errors are the median over up to fifty
// landmarks that agree where the frame is located by itself. CHROME names the browser.
import { readdir } from "node:fs/promises";
import { join, normalize, resolve } from "node:path";
import { blankPage, root } from "./blank_page.mjs";
import { readPoses } from "./pose_list.mjs";

const [packageFolder, scene, pictures, posesFile, focalText, prefix = "", first = "0", end = "10000", passes = "4", fps = "30"] = process.argv.slice(2);
if (!focalText) throw new Error("usage: node benches/follow_browser.mjs PACKAGE SCENE PICTURES POSES FOCAL [PREFIX] [FIRST] [END] [PASSES] [FPS]");
const focal = Number(focalText);
const known = await readPoses(posesFile);
const all = (await readdir(pictures)).filter((name) => /\.(jpe?g|png)$/i.test(name) && name.startsWith(prefix)).sort();
const names = all.slice(Number(first), Number(end)).filter((name) => known.has(name));
if (names.length < 2) throw new Error(`${names.length} pictures with a pose; the list names ${[...known.keys()].slice(0, 2).join(", ")} and others`);

const bases = { package: resolve(packageFolder), pictures: resolve(pictures) };
const { page, browser, close } = await blankPage((path) => {
  if (path === "/scene.landline") return resolve(scene);
  const [, folder, ...rest] = path.split("/");
  const file = bases[folder] && join(bases[folder], normalize(rest.join("/")));
  return file?.startsWith(bases[folder]) ? file : undefined;
}, 3_600_000);
page.on("pageerror", (error) => console.error(error));
console.error(`Chromium ${browser.version()}, ${names.length} frames, ${passes} passes`);

const { alone, shown, answers, dropped, size } = await page.evaluate(
  async ({ names, focal, passes, fps }) => {
    const { Relocalizer, follow } = await import("/package/index.js");
    const relocalizer = await Relocalizer.create({ scene: "/scene.landline", device: "cpu" });
    const load = async (name) => createImageBitmap(await (await fetch(`/pictures/${name}`)).blob(), { colorSpaceConversion: "none" });
    const frames = await Promise.all(names.map(load));
    const { width, height } = frames[0];
    const intrinsics = { fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height };
    const alone = [];
    for (const frame of frames) {
      const result = await relocalizer.locate(await createImageBitmap(frame), { intrinsics, include: ["points"], tracking: false });
      const { world, isInlier } = result.points ?? { world: [] };
      const marks = [];
      for (let i = 0; i < world.length / 3; i++) if (isInlier[i]) marks.push([...world.subarray(3 * i, 3 * i + 3)]);
      const step = Math.ceil(marks.length / 50);
      alone.push({ pose: result.located ? [...result.placement.cameraFromWorld] : null, marks: marks.filter((_, i) => i % step === 0) });
    }

    const [bits, side] = [10, 16];
    const screen = Object.assign(document.createElement("canvas"), { width, height });
    const paint = screen.getContext("2d");
    const put = (k) => {
      paint.drawImage(frames[k], 0, 0);
      for (let b = 0; b < bits; b++) {
        paint.fillStyle = (k >> b) & 1 ? "#fff" : "#000";
        paint.fillRect(side * b, height - side, side, side);
      }
    };
    const corner = Object.assign(document.createElement("canvas"), { width: side * bits, height: side }).getContext("2d", { willReadFrequently: true });
    const numberOf = (source) => {
      corner.drawImage(source, 0, height - side, side * bits, side, 0, 0, side * bits, side);
      const { data } = corner.getImageData(0, side / 2, side * bits, 1);
      let k = 0;
      for (let b = 0; b < bits; b++) k |= (data[4 * (side * b + side / 2)] > 127 ? 1 : 0) << b;
      return k;
    };
    put(0);
    const video = Object.assign(document.createElement("video"), { muted: true, srcObject: screen.captureStream(fps) });
    await video.play();
    const [shown, answers] = [[], []];
    let [last, asked, step] = [null, performance.now(), -1];
    let begun;
    const located = new Promise((done) => (begun = done));
    const loop = follow(relocalizer, video, {
      intrinsics,
      // The last answer is still under way when the relocalizer goes.
      onError: (error) => error.code === "disposed" || reportError(error),
      onResult(result) {
        if (result.located) begun();
        if (step < 0) return;
        const at = numberOf(result.frame.source);
        shown.push({ at, pose: result.located ? [...result.placement.cameraFromWorld] : null, last, ms: result.trackingMs, age: result.located ? result.age.frames : null });
      },
      onAnswer({ result }) {
        answers.push(performance.now() - asked);
        asked = performance.now();
        if (result.located) last = [...result.placement.cameraFromWorld];
      },
    });
    // Still until there is a first pose; frames of a stream that does not change are not sent, so something has to.
    let waiting = setInterval(() => put(0), 1000 / fps);
    await located;
    clearInterval(waiting);
    answers.length = 0;
    const n = frames.length;
    const start = performance.now();
    await new Promise((done) => {
      const tick = () => {
        const now = Math.floor(((performance.now() - start) / 1000) * fps);
        if (now >= passes * (n - 1)) return done();
        if (now > step) {
          step = now;
          const phase = step % (2 * (n - 1));
          put(phase < n ? phase : 2 * (n - 1) - phase);
        }
        waiting = setTimeout(tick, Math.max(1, start + ((step + 1) * 1000) / fps - performance.now()));
      };
      tick();
    });
    const { dropped } = loop;
    loop.stop();
    await relocalizer.dispose();
    return { alone, shown, answers, dropped, size: [width, height] };
  },
  { names, focal, passes: Number(passes), fps: Number(fps) },
);
await close();

const at = (values, q) => values.sort((a, b) => a - b)[Math.min(values.length - 1, Math.floor(q * values.length))] ?? NaN;
const camera = (m, p) => [0, 1, 2].map((r) => m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3]);
const pixel = (m, p) => {
  const [x, y, z] = camera(m, p);
  return z > 0 ? [size[0] / 2 + (focal * x) / z, size[1] / 2 + (focal * y) / z] : undefined;
};
const centre = (m) => [0, 1, 2].map((c) => -(m[c] * m[3] + m[4 + c] * m[7] + m[8 + c] * m[11]));
/** Position in hundredths, rotation in degrees and overlay in pixels of a pose at a frame. */
function errors(pose, k) {
  if (!pose) return [Infinity, Infinity, Infinity];
  const truth = known.get(names[k]);
  const [a, b] = [centre(pose), centre(truth)];
  let trace = 0;
  for (const i of [0, 1, 2, 4, 5, 6, 8, 9, 10]) trace += pose[i] * truth[i];
  const off = [];
  for (const mark of alone[k].marks) {
    const [here, there] = [pixel(pose, mark), pixel(truth, mark)];
    if (there) off.push(here ? Math.hypot(here[0] - there[0], here[1] - there[1]) : Infinity);
  }
  return [100 * Math.hypot(...a.map((v, i) => v - b[i])), (180 / Math.PI) * Math.acos(Math.min(1, (trace - 1) / 2)), at(off, 0.5)];
}
const rows = shown.filter(({ at, last }) => last && at < names.length);
const row = (name, of) => {
  const found = rows.map((shown) => errors(of(shown), shown.at));
  const two = (i, digits) => [0.5, 0.9].map((q) => at(found.map((e) => e[i]), q).toFixed(digits)).join(", ");
  console.log(`| ${name} | ${found.filter((e) => e[0] < Infinity).length} of ${rows.length} | ${two(0, 2)} | ${two(1, 3)} | ${two(2, 2)} |`);
};
console.log("| | frames with a pose | position, hundredths of a unit, median and 90 % | rotation, degrees | overlay, pixels |");
console.log("| --- | --- | --- | --- | --- |");
row("each frame located by itself, as if at once", (shown) => alone[shown.at].pose);
row("before: the last answer over the newest frame", (shown) => shown.last);
row("after: followed", (shown) => shown.pose);
/** Turn of a pose against the true one as a vector in degrees (it is small), and shift of its centre in hundredths. */
function off(pose, k) {
  const truth = known.get(names[k]);
  const turn = (r, c) => [0, 1, 2].reduce((sum, i) => sum + pose[4 * r + i] * truth[4 * c + i], 0);
  const angles = [turn(2, 1) - turn(1, 2), turn(0, 2) - turn(2, 0), turn(1, 0) - turn(0, 1)].map((v) => (90 / Math.PI) * v);
  const [a, b] = [centre(pose), centre(truth)];
  return [angles, a.map((v, i) => 100 * (v - b[i]))];
}
/** Median length about the mean, and the mean's length: what all share is the reference's or the map's. */
const spread = (vectors) => {
  const mean = [0, 1, 2].map((i) => vectors.reduce((sum, v) => sum + v[i], 0) / vectors.length);
  return [at(vectors.map((v) => Math.hypot(...v.map((x, i) => x - mean[i]))), 0.5), Math.hypot(...mean)];
};
for (const [name, of] of [["located by itself", (shown) => alone[shown.at].pose], ["followed", (shown) => shown.pose]]) {
  const all = rows.filter((shown) => of(shown)).map((shown) => off(of(shown), shown.at));
  const [turn, shift] = [0, 1].map((i) => spread(all.map((e) => e[i])));
  console.log(`${name}: rotation ${turn[0].toFixed(3)} degrees in the median about a mean of ${turn[1].toFixed(3)}, position ${shift[0].toFixed(2)} hundredths about ${shift[1].toFixed(2)}`);
}
const painted = Number(passes) * (names.length - 1);
const ms = shown.map((s) => s.ms);
console.log(`${painted} frames painted, ${shown.length} with a result, ${dropped} dropped by the loop; a frame ${at(ms, 0.5).toFixed(2)} ms of the page's thread (median), ${at(ms, 0.99).toFixed(2)} ms (99 %)`);
console.log(`an answer every ${at(answers, 0.5).toFixed(0)} ms (median), ${at(answers, 0.9).toFixed(0)} ms (90 %); its age at the frame ${at(shown.map((s) => s.age ?? 0), 0.5)} frames (median)`);
