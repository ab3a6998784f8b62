// What a follower draws in a slow pan: eight frames as a strip to look at, and by numbers.
import assert from "node:assert/strict";
import { writeFile } from "node:fs/promises";
import { test } from "node:test";
import { artefact, blank, haveSample } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("marks stay on their places in the picture that is shown, in a pan", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const seen = await page.evaluate(async () => {
    const { follow, project } = globalThis.landline;
    const { camera, pictures } = globalThis.sample;
    const { width, height, fx, fy, cx, cy } = camera;
    const [step, reach] = [0.25, 20];
    const canvas = (w, h) => Object.assign(document.createElement("canvas"), { width: w, height: h });
    const turn = (k) => (k * step * Math.PI) / 180;

    // A sample picture as its camera sees it from the same place, turned to the side; what lies beyond its edges is its edge.
    const still = canvas(width, height).getContext("2d");
    still.drawImage(await createImageBitmap(await globalThis.picture(0)), 0, 0);
    const from = new Uint32Array(still.getImageData(0, 0, width, height).data.buffer);
    const turned = async (k) => {
      const [c, s] = [Math.cos(turn(k)), Math.sin(turn(k))];
      const picture = new ImageData(width, height);
      const to = new Uint32Array(picture.data.buffer);
      const clamp = (v, n) => Math.min(Math.max(Math.floor(v), 0), n - 1);
      for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++) {
          // The ray of the turned camera in the axes of the other one.
          const [u, v] = [(x + 0.5 - cx) / fx, (y + 0.5 - cy) / fy];
          const z = c - s * u;
          to[y * width + x] = from[clamp(cy + (fy * v) / z, height) * width + clamp(cx + (fx * (c * u + s)) / z, width)];
        }
      }
      return createImageBitmap(picture);
    };
    const frames = new Map();
    for (let k = -reach; k <= reach; k++) frames.set(k, await turned(k));
    /** The true pose of a turned frame, as `project` takes it. */
    const truth = (k) => {
      const [c, s] = [Math.cos(turn(k)), Math.sin(turn(k))];
      const [x, y, z] = pictures[0].cam_from_world;
      return { cameraFromWorld: Float64Array.from([...x.map((v, i) => c * v - s * z[i]), ...y, ...x.map((v, i) => s * v + c * z[i])]) };
    };

    const relocalizer = await globalThis.make();
    const { points } = await relocalizer.locate(await globalThis.picture(0), { intrinsics: camera, include: ["points"] });
    const marks = [];
    for (let i = 0; i < points.pixels.length / 2 && marks.length < 12; i += Math.ceil(points.pixels.length / 40)) marks.push([...points.world.subarray(3 * i, 3 * i + 3)]);

    // To and fro at 12.6 degrees a second; the number of the turn stands in the picture's corner, in black and white.
    const shown = canvas(width, height);
    const paint = shown.getContext("2d");
    const begin = performance.now();
    const bits = 6;
    const timer = setInterval(() => {
      const period = (4 * reach * step) / 12.6;
      const phase = ((performance.now() - begin) / 1000 / period) % 1;
      const k = Math.round(reach * (1 - 4 * Math.abs(phase - 0.5)));
      paint.drawImage(frames.get(k), 0, 0);
      for (let b = 0; b < bits; b++) {
        paint.fillStyle = ((k + reach) >> b) & 1 ? "#fff" : "#000";
        paint.fillRect(16 * b, height - 16, 16, 16);
      }
    }, 33);
    const video = document.createElement("video");
    video.muted = true;
    video.srcObject = shown.captureStream(30);
    await video.play();

    const strip = canvas(4 * (width / 2), 2 * (height / 2));
    const drawn = strip.getContext("2d");
    const work = canvas(width, height).getContext("2d", { willReadFrequently: true });
    const cells = [];
    let last = 0;
    await new Promise((done, fail) => {
      const loop = follow(relocalizer, video, {
        intrinsics: camera,
        onError: fail,
        onResult(result) {
          // The first second settles; then a frame every fifth of a second.
          if (!result.located || result.by !== "tracking" || performance.now() - last < (last ? 200 : 0)) return;
          if (last === 0) {
            last = performance.now() + 800;
            return;
          }
          last = performance.now();
          result.frame.draw(work);
          let code = 0;
          for (let b = 0; b < bits; b++) code |= (work.getImageData(16 * b + 8, height - 8, 1, 1).data[0] > 127 ? 1 : 0) << b;
          const k = code - reach;
          const off = [];
          for (const world of marks) {
            const here = project(result.placement, camera, world);
            const there = project(truth(k), camera, world);
            if (!here || !there) continue;
            off.push(Math.hypot(here[0] - there[0], here[1] - there[1]));
            work.strokeStyle = "#0f0";
            work.lineWidth = 2;
            work.beginPath();
            work.arc(here[0], here[1], 9, 0, 2 * Math.PI);
            work.moveTo(there[0] - 4, there[1]);
            work.lineTo(there[0] + 4, there[1]);
            work.moveTo(there[0], there[1] - 4);
            work.lineTo(there[0], there[1] + 4);
            work.stroke();
          }
          off.sort((a, b) => a - b);
          drawn.drawImage(work.canvas, (cells.length % 4) * (width / 2), Math.floor(cells.length / 4) * (height / 2), width / 2, height / 2);
          cells.push({ turn: k * step, marks: off.length, median: off[off.length >> 1], age: result.age.frames });
          if (cells.length < 8) return;
          loop.stop();
          done();
        },
      });
    });
    clearInterval(timer);
    await relocalizer.dispose();
    return { cells, png: strip.toDataURL("image/png").split(",")[1] };
  });
  await writeFile(artefact("follow-pan.png"), Buffer.from(seen.png, "base64"));
  t.diagnostic(seen.cells.map(({ turn, median, age }) => `${turn} deg: ${median.toFixed(2)} px, ${age} frames after the answer's`).join("; "));
  assert.equal(seen.cells.length, 8);
  assert.ok(new Set(seen.cells.map(({ turn }) => turn)).size >= 4, "the camera turns");
  for (const { turn, marks, median } of seen.cells) {
    assert.ok(marks >= 6 && median < 4, `${marks} marks, ${median} px off at ${turn} degrees`);
  }
});

test("a video that does not play, and a relocalizer that is gone, are told once", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const seen = await page.evaluate(async () => {
    const { follow } = globalThis.landline;
    const relocalizer = await globalThis.make();
    const told = (video, then = () => undefined) =>
      new Promise((done) => {
        const errors = [];
        const loop = follow(relocalizer, video, { onError: ({ code, message }) => errors.push({ code, message }) });
        loop.addEventListener("error", () => setTimeout(() => done(errors), 300));
        then();
      });
    const broken = document.createElement("video");
    const during = await told(broken, () => (broken.src = URL.createObjectURL(new Blob(["no video"], { type: "video/mp4" }))));
    const before = await told(broken);

    const canvas = Object.assign(document.createElement("canvas"), { width: 320, height: 240 });
    const paint = canvas.getContext("2d");
    const timer = setInterval(() => paint.fillRect(Math.random() * 320, 0, 9, 9), 33);
    const video = Object.assign(document.createElement("video"), { muted: true, srcObject: canvas.captureStream(30) });
    await video.play();
    const gone = await told(video, () => setTimeout(() => relocalizer.dispose(), 500));
    clearInterval(timer);
    return { during, before, gone };
  });
  for (const errors of [seen.during, seen.before]) {
    assert.deepEqual(errors.map(({ code }) => code), ["asset-fetch"]);
    assert.match(errors[0].message, /^the video does not play: ./);
  }
  assert.deepEqual(seen.gone.map(({ code }) => code), ["disposed"]);
});
