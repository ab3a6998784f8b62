// What the engine takes and what it tells over several frames: kinds of pictures, states, focal lengths.
import assert from "node:assert/strict";
import { test } from "node:test";
import { blank, haveSample, sceneOfUnknownCamera, softwareGpu } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";

test("every kind of picture is taken, and the same pixels give the same position", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const { positions: seen, reason } = await page.evaluate(async () => {
    const intrinsics = globalThis.sample.camera;
    const { width, height } = intrinsics;
    const relocalizer = await globalThis.make();
    const blob = await globalThis.picture(0);
    const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
    const onscreen = document.createElement("canvas");
    const offscreen = new OffscreenCanvas(width, height);
    for (const canvas of [onscreen, offscreen]) {
      canvas.width = width;
      canvas.height = height;
      canvas.getContext("2d", { alpha: false }).drawImage(bitmap, 0, 0);
    }
    const pixels = offscreen.getContext("2d").getImageData(0, 0, width, height);
    const rgb = new Uint8Array(3 * width * height);
    for (let i = 0; i < width * height; i++) rgb.set(pixels.data.subarray(4 * i, 4 * i + 3), 3 * i);
    // Rows with something behind them, as video decoders leave them.
    const stride = 4 * width + 32;
    const padded = new Uint8Array(stride * height);
    for (let y = 0; y < height; y++) padded.set(pixels.data.subarray(4 * width * y, 4 * width * (y + 1)), stride * y);
    const image = new Image();
    image.src = URL.createObjectURL(blob);
    await image.decode();
    const video = await globalThis.playing(onscreen);
    const frame = new VideoFrame(offscreen, { timestamp: 0 });
    const kinds = {
      ImageData: pixels,
      ImageBitmap: bitmap,
      Blob: blob,
      canvas: onscreen,
      OffscreenCanvas: offscreen,
      image,
      VideoFrame: frame,
      rgba8: { data: pixels.data, width, height, format: "rgba8" },
      rgb8: { data: rgb, width, height, format: "rgb8" },
      padded: { data: padded, width, height, stride, format: "rgba8" },
      video,
    };
    const positions = {};
    for (const [kind, source] of Object.entries(kinds)) {
      const { placement, reason } = await relocalizer.locate(source, { intrinsics });
      positions[kind] = placement ? Object.values(placement.position) : reason;
    }
    frame.close();
    const empty = new OffscreenCanvas(width, height);
    empty.getContext("2d").clearRect(0, 0, 1, 1);
    const { reason } = await relocalizer.locate(empty, { intrinsics });
    await relocalizer.dispose();
    return { positions, reason };
  });
  assert.equal(reason, "few-features", "a transparent picture does not show the one before it");
  for (const [kind, position] of Object.entries(seen)) {
    const apart = Math.max(...position.map((v, i) => Math.abs(v - seen.ImageData[i])));
    // Video frames may pass through another colour format, which rounds.
    assert.ok(apart <= (/video/i.test(kind) ? 0.02 : 0), `${kind}: ${position}, ${apart} from ImageData`);
  }
});

test("states over several frames are told as events, with what limits them", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const heard = await page.evaluate(async () => {
    const intrinsics = globalThis.sample.camera;
    const relocalizer = await globalThis.make({ smoothing: "steady" });
    const events = [];
    for (const name of ["searching", "tracking", "limited"]) {
      relocalizer.addEventListener(name, ({ detail }) => events.push(detail.limited ? `${name}: ${detail.limited}` : name));
    }
    const here = await createImageBitmap(await globalThis.picture(0));
    const there = await createImageBitmap(await globalThis.picture(12));
    const wall = new ImageData(640, 480);
    let timestamp = 1000;
    const show = (picture) => relocalizer.locate(picture, { intrinsics, tracking: true, timestamp: (timestamp += 33) });
    const first = await show(here);
    for (let i = 0; i < 5; i++) await show(wall);
    await show(here);
    await show(there);
    await show(there);
    await relocalizer.reset();
    events.push(`reset: ${relocalizer.state}`);
    await relocalizer.dispose();
    return { events, smoothed: first.unsmoothed !== undefined };
  });
  assert.deepEqual(heard.events, ["tracking", "limited: lost", "searching", "tracking", "limited: jump", "tracking", "reset: searching"]);
  assert.ok(heard.smoothed, "with smoothing on, the position before it is there too");
});

test("the focal length is solved, learned per camera, read from EXIF and from the track", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  await page.route("**/unknown.landline", async (route) => route.fulfill({ contentType: "application/octet-stream", body: await sceneOfUnknownCamera() }));
  const seen = await page.evaluate(async () => {
    const { focalLength35mm, follow } = globalThis.landline;
    const scene = "./unknown.landline";
    const relocalizer = await globalThis.make({ scene });
    const learned = [];
    for (let i = 0; i < globalThis.sample.pictures.length; i++) {
      const { located, intrinsics } = await relocalizer.locate(await globalThis.picture(i), { camera: "back" });
      learned.push({ located, ...intrinsics });
    }
    const later = await globalThis.make({ scene });
    await later.recallCamera("back", learned.at(-1).fx / 640);
    const { located, intrinsics } = await later.locate(await globalThis.picture(learned.findIndex((one) => one.located)), { camera: "back" });
    const recalled = { located, ...intrinsics, nonsense: await globalThis.failure(later.recallCamera("back", -1)) };
    await later.dispose();
    const other = (await relocalizer.locate(await globalThis.picture(0), { camera: "front" })).intrinsics.source;

    // An EXIF block with FocalLengthIn35mmFilm = 28 right after the start of the picture.
    const sharp = learned.findIndex(({ located }) => located);
    const jpeg = new Uint8Array(await (await globalThis.picture(sharp)).arrayBuffer());
    const tiff = [0x49, 0x49, 42, 0, 8, 0, 0, 0, 1, 0, 0x69, 0x87, 4, 0, 1, 0, 0, 0, 26, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0x05, 0xa4, 3, 0, 1, 0, 0, 0, 28, 0, 0, 0, 0, 0, 0, 0];
    const block = [0xff, 0xe1, 0, tiff.length + 8, 0x45, 0x78, 0x69, 0x66, 0, 0, ...tiff];
    const withExif = new Uint8Array([...jpeg.subarray(0, 2), ...block, ...jpeg.subarray(2)]);
    const exif = await relocalizer.locate(new Blob([withExif], { type: "image/jpeg" }));

    // No browser fills these in yet; the names are those of the W3C proposal.
    const canvas = document.createElement("canvas");
    canvas.width = 640;
    canvas.height = 480;
    canvas.getContext("2d").drawImage(await createImageBitmap(await globalThis.picture(0)), 0, 0);
    const video = await globalThis.playing(canvas);
    const { getSettings } = MediaStreamTrack.prototype;
    MediaStreamTrack.prototype.getSettings = function () {
      return { ...getSettings.call(this), width: 640, height: 480, focalLengthX: globalThis.sample.camera.fx };
    };
    const track = await new Promise((done, fail) => {
      const loop = follow(relocalizer, video, {
        camera: "track",
        onAnswer: ({ result }) => {
          loop.stop();
          done(result);
        },
        onError: fail,
      });
    });
    await relocalizer.dispose();
    return { learned, recalled, other, millimetres: focalLength35mm(withExif), exif: { located: exif.located, ...exif.intrinsics }, track: { located: track.located, ...track.intrinsics }, truth: globalThis.sample.camera.fx };
  });
  const off = (f) => Math.abs(f / seen.truth - 1);
  t.diagnostic(`learned: ${seen.learned.map(({ source, fx }) => `${source} ${fx.toFixed(1)}`).join(", ")}; true ${seen.truth}; EXIF: ${seen.exif.fx.toFixed(1)}`);
  // A picture may leave its focal length open; the first that does not has it solved.
  assert.equal(seen.learned.find(({ located }) => located)?.source, "estimated");
  assert.equal(seen.learned.at(-1).source, "remembered");
  assert.ok(seen.learned.at(-1).relativeSigma === undefined || seen.learned.at(-1).relativeSigma < 0.05);
  assert.ok(off(seen.learned.at(-1).fx) < 0.03, `learned ${seen.learned.at(-1).fx} of ${seen.truth}`);
  assert.ok(seen.recalled.located && seen.recalled.source === "remembered" && off(seen.recalled.fx) < 0.04, JSON.stringify(seen.recalled));
  assert.equal(seen.recalled.nonsense, "bad-input");
  assert.notEqual(seen.other, "remembered", "another camera has learned nothing");
  assert.equal(seen.millimetres, 28);
  assert.ok(seen.exif.located && seen.exif.source === "exif" && off(seen.exif.fx) < 0.05, JSON.stringify(seen.exif));
  assert.ok(seen.track.located && seen.track.source === "track" && off(seen.track.fx) < 1e-9, JSON.stringify(seen.track));
});

test("a frame of the scene's own camera needs no intrinsics, another camera is found out, and why a picture has no place is said", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const seen = await page.evaluate(async () => {
    const { camera } = globalThis.sample;
    const relocalizer = await globalThis.make();
    const short = ({ located, reason, warning, turnClockwiseDeg, intrinsics }) => ({ located, reason, warning, turnClockwiseDeg, source: intrinsics.source, fx: intrinsics.fx });
    /** The middle of a picture, enlarged and turned, as a file or as pixels. */
    const changed = async (i, { zoom = 1, quarters = 0, scale = 1 }) => {
      const bitmap = await createImageBitmap(await globalThis.picture(i));
      const [w, h] = [camera.width * scale, camera.height * scale];
      const canvas = new OffscreenCanvas(...(quarters % 2 ? [h, w] : [w, h]));
      const context = canvas.getContext("2d");
      context.translate(canvas.width / 2, canvas.height / 2);
      context.rotate((quarters * Math.PI) / 2);
      context.drawImage(bitmap, (-w * zoom) / 2, (-h * zoom) / 2, w * zoom, h * zoom);
      return canvas;
    };
    const file = async (...what) => (await changed(...what)).convertToBlob({ type: "image/png" });
    const own = [];
    for (const scale of [1, 0.5]) own.push(short(await relocalizer.locate(await changed(0, { scale }))));
    const zoomed = short(await relocalizer.locate(await changed(4, { zoom: 1.3 })));
    const given = (fx) => ({ intrinsics: { ...camera, fx, fy: fx } });
    const wrong = [];
    for (const factor of [0.8, 1.25]) wrong.push(short(await relocalizer.locate(await globalThis.picture(4), given(factor * camera.fx))));
    // One focal length alone: the picture is not squeezed.
    for (const other of [{ fy: 600 }, { fy: 700 }, { fx: 640 }, { cx: 620 }, { cx: 0, cy: 0 }]) wrong.push(short(await relocalizer.locate(await globalThis.picture(0), { intrinsics: { ...camera, ...other } })));
    // Squeezed to another shape, and told as a part of a picture.
    const low = new OffscreenCanvas(camera.width, 400);
    low.getContext("2d").drawImage(await createImageBitmap(await globalThis.picture(0)), 0, 0, camera.width, 400);
    wrong.push(short(await relocalizer.locate(low, { intrinsics: { ...camera, cy: 200, height: 400 } })));
    const mirror = new OffscreenCanvas(camera.width, camera.height);
    const context = mirror.getContext("2d");
    context.setTransform(-1, 0, 0, 1, camera.width, 0);
    context.drawImage(await createImageBitmap(await globalThis.picture(0)), 0, 0);
    const mirrored = await relocalizer.locate(mirror, { intrinsics: camera, explain: true, include: ["points", "lines"] });
    const agreeing = [...mirrored.points.isInlier, ...mirrored.lines.isInlier, mirrored.quality.pointInliers, mirrored.quality.lineInliers].reduce((a, b) => a + Number(b), 0);
    const turned = [];
    for (const quarters of [1, 3]) turned.push(short(await relocalizer.locate(await file(0, { quarters }))));
    const asked = short(await relocalizer.locate(await changed(0, { quarters: 1 }), { explain: true }));
    // Pixels are not looked into, nor is a file as the frame of a moving camera.
    const light = [short(await relocalizer.locate(await changed(0, { quarters: 1 }))), short(await relocalizer.locate(await file(0, { quarters: 1 }), { tracking: true }))];
    await relocalizer.dispose();
    return { own, zoomed, wrong, mirrored: [mirrored.located, mirrored.reason, mirrored.state, agreeing], turned, asked, light, truth: camera.fx };
  });
  t.diagnostic(JSON.stringify(seen));
  assert.ok(seen.own.every(({ located, source }) => located && source === "scene"));
  assert.ok(Math.abs(seen.own[0].fx - seen.truth) < 1e-9 && Math.abs(2 * seen.own[1].fx - seen.truth) < 1e-9);
  assert.ok(seen.zoomed.located && seen.zoomed.source === "estimated" && seen.zoomed.warning === undefined, "nobody gave intrinsics");
  assert.ok(Math.abs(seen.zoomed.fx / (1.3 * seen.truth) - 1) < 0.03);
  for (const { located, warning, fx } of seen.wrong) assert.ok(located && warning === "focal-mismatch" && Math.abs(fx / seen.truth - 1) < 0.02);
  assert.deepEqual(seen.mirrored, [false, "mirrored", "searching", 0]);
  assert.deepEqual(seen.turned.map(({ reason, turnClockwiseDeg }) => [reason, turnClockwiseDeg]), [["turned", 270], ["turned", 90]]);
  assert.deepEqual([seen.asked.reason, seen.asked.turnClockwiseDeg], ["turned", 270]);
  assert.ok(seen.light.every(({ located, reason, turnClockwiseDeg }) => !located && reason !== "turned" && turnClockwiseDeg === undefined));
});

test("on the GPU a frame that waits is begun early, and gets the answer that it gets alone", { skip, timeout: 240_000 }, async (t) => {
  const { page, said } = await blank(t, softwareGpu);
  const seen = await page.evaluate(async () => {
    const intrinsics = globalThis.sample.camera;
    const relocalizer = await globalThis.make({ device: "webgpu", maxSide: 320 });
    const pictures = await Promise.all([0, 6, 12].map((i) => globalThis.picture(i)));
    // Small, for the software adapter takes ten seconds for a whole picture. What is to be explained waits for nobody.
    const locate = (picture) => relocalizer.locate(picture, { intrinsics, explain: false });
    const told = (result) => ({ backend: result.backend, located: result.located, keypoints: result.quality.keypoints, inliers: result.quality.pointInliers, position: result.placement?.position });
    const alone = [];
    for (const picture of pictures) alone.push(told(await locate(picture)));
    // A bad frame between good ones fails in its turn, and alone.
    const bad = { data: new Uint8Array(33 * 4000), width: 33, height: 4000, format: "luma8" };
    const together = await Promise.allSettled([locate(pictures[0]), locate(pictures[1]), locate(bad), relocalizer.setOptions({}), locate(pictures[2])]);
    const backend = relocalizer.backend;
    await relocalizer.dispose();
    return { alone, backend, failed: together[2].reason?.code, together: [0, 1, 4].map((i) => told(together[i].value)) };
  });
  assert.equal(seen.backend, "webgpu");
  assert.ok(seen.alone.every((result) => result.backend === "webgpu" && result.located), JSON.stringify(seen.alone));
  assert.deepEqual(seen.together, seen.alone);
  assert.equal(seen.failed, "bad-input");
  assert.deepEqual(said, []);
});
