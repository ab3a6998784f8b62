// Calls that wait: the order of answers, giving up, the camera's own calls, and what nobody listens for.
import assert from "node:assert/strict";
import { test } from "node:test";
import { blank, haveSample } from "./page.mjs";

const skip = haveSample() ? false : "the sample scene is not there: run `cargo xtask sample`";
/** Two cameras that need no permission. */
const twoCameras = ["--use-fake-device-for-media-stream=device-count=2", "--use-fake-ui-for-media-stream"];

test("files are answered in the order of the calls, however long their decoding takes", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const seen = await page.evaluate(async () => {
    const small = await globalThis.picture(0);
    const bitmap = await createImageBitmap(small);
    const canvas = new OffscreenCanvas(6400, 4800);
    canvas.getContext("2d").drawImage(bitmap, 0, 0, 6400, 4800);
    const large = await canvas.convertToBlob({ type: "image/png" });
    const relocalizer = await globalThis.make();
    const order = [];
    const ask = (name, blob) => relocalizer.locate(blob, { intrinsics: globalThis.sample.camera, explain: false }).then(({ frame }) => order.push(`${name} ${frame.width}`));
    const broken = globalThis.failure(relocalizer.locate(new Blob(["no picture"])));
    await Promise.all([ask("large", large), ask("small", small), ask("small again", small)]);
    return { order, broken: await broken, idle: relocalizer.idle };
  });
  assert.deepEqual(seen, { order: ["large 6400", "small 640", "small again 640"], broken: "bad-input", idle: true });
});

test("a frame that is given up rejects at once, and the next one is located", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t);
  const seen = await page.evaluate(async () => {
    const { failure, make } = globalThis;
    const relocalizer = await make();
    const canvas = new OffscreenCanvas(640, 480).getContext("2d");
    canvas.drawImage(await createImageBitmap(await globalThis.picture(0)), 0, 0);
    const pixels = canvas.getImageData(0, 0, 640, 480);
    const options = { intrinsics: globalThis.sample.camera };
    const stop = new AbortController();
    const order = [];
    let results = 0;
    relocalizer.addEventListener("result", () => (results += 1));
    const waited = relocalizer.locate(pixels, options).then(() => order.push("before"));
    const given = failure(relocalizer.locate(pixels, { ...options, signal: stop.signal })).then((name) => order.push(name));
    // Both are with the engine by now.
    await new Promise((done) => setTimeout(done));
    stop.abort();
    await given;
    const stillBusy = !relocalizer.idle;
    await waited;
    const { located } = await relocalizer.locate(pixels, options);
    return { order, stillBusy, located, results };
  });
  assert.deepEqual(seen, { order: ["AbortError", "before"], stillBusy: true, located: true, results: 2 });
});

test("a camera: lists, flips, light, and giving up while the browser asks", { skip, timeout: 240_000 }, async (t) => {
  const { page } = await blank(t, twoCameras);
  const seen = await page.evaluate(async () => {
    const { camera, cameras } = globalThis.landline;
    const { failure } = globalThis;
    const told = (promise) => promise.then(() => "no error", ({ code, message }) => `${code}: ${message}`);
    const wrong = await told(camera({ device: "front" }));
    // A question that the user answers late: what it opens is closed.
    const real = navigator.mediaDevices.getUserMedia.bind(navigator.mediaDevices);
    let answer;
    navigator.mediaDevices.getUserMedia = (asked) => new Promise((done) => (answer = () => real(asked).then((stream) => (done(stream), stream))));
    const stop = new AbortController();
    const waiting = failure(camera({ signal: stop.signal }));
    stop.abort();
    const given = await waiting;
    const late = await answer();
    await new Promise((done) => setTimeout(done, 50));
    navigator.mediaDevices.getUserMedia = real;
    const opened = await camera();
    const all = await cameras();
    const [video, label, key] = [opened.video, opened.stream.getVideoTracks()[0].label, opened.key()];
    const before = opened.stream.getVideoTracks()[0];
    await opened.flip();
    const flipped = { same: opened.video === video, other: opened.stream.getVideoTracks()[0].label !== label, key: opened.key() !== key, plays: !video.paused && video.videoWidth > 0, old: before.readyState };
    const torch = await opened.torch(true);
    // The other one is gone: the present one comes back.
    navigator.mediaDevices.getUserMedia = (asked) => (asked.video.deviceId?.exact === all.find((one) => one.label === label).deviceId ? Promise.reject(new DOMException("gone", "NotReadableError")) : real(asked));
    const failed = await failure(opened.flip());
    const kept = opened.stream.getVideoTracks()[0].readyState;
    opened.stop();
    const alone = await globalThis.landline.camera({ facing: "user" });
    navigator.mediaDevices.enumerateDevices = async () => [];
    const none = await told(alone.flip());
    alone.stop();
    return { wrong, given, late: late.getVideoTracks()[0].readyState, names: new Set(all.map((one) => one.label)).size, ids: all.every((one) => one.deviceId !== ""), flipped, torch, failed, kept, none };
  });
  assert.deepEqual(seen, {
    wrong: 'bad-input: camera() has no option "device"',
    given: "AbortError",
    late: "ended",
    names: 2,
    ids: true,
    flipped: { same: true, other: true, key: true, plays: true, old: "ended" },
    torch: false,
    failed: "camera-busy",
    kept: "live",
    none: "camera-unavailable: there is no other camera",
  });
});

test("following: the page's own mistakes come to the console, intrinsics of another shape are told once", { skip, timeout: 240_000 }, async (t) => {
  const { page, said } = await blank(t);
  const seen = await page.evaluate(async () => {
    const { follow } = globalThis.landline;
    const relocalizer = await globalThis.make();
    const canvas = Object.assign(document.createElement("canvas"), { width: 640, height: 480 });
    canvas.getContext("2d").drawImage(await createImageBitmap(await globalThis.picture(0)), 0, 0);
    const video = await globalThis.playing(canvas);
    let unknown = "nothing";
    try {
      follow(relocalizer, video, { onresult() {} });
    } catch ({ code, message }) {
      unknown = `${code}: ${message}`;
    }
    const watch = (options, until) => new Promise((done) => {
      const loop = follow(relocalizer, video, options);
      const look = () => (until(loop) ? (loop.stop(), done()) : setTimeout(look, 50));
      look();
    });
    const turned = { ...globalThis.sample.camera, width: 480, height: 640 };
    const errors = [];
    const sources = [];
    await watch({ intrinsics: turned, onError: (error) => errors.push(error), onAnswer: ({ result }) => sources.push(result.intrinsics.source) }, () => sources.length >= 3);
    // Nobody listens: the console does.
    await watch({ intrinsics: turned }, (loop) => loop.answered >= 2);
    await watch({ onResult: () => globalThis.nothingOfThisName.draw() }, (loop) => loop.processed >= 2);
    await relocalizer.dispose();
    return { unknown, errors: errors.map(({ code, message }) => `${code}: ${message}`), given: sources.includes("given") };
  });
  assert.deepEqual(seen, {
    unknown: 'bad-input: follow() has no option "onresult"',
    errors: ["bad-input: the intrinsics are for 480 x 640, the video is 640 x 480: the shapes differ, so they are left out"],
    given: false,
  });
  assert.equal(said.filter((text) => /shapes differ/.test(text)).length, 1, said.join("\n"));
  assert.ok(said.some((text) => /reading 'draw'/.test(text)), said.join("\n"));
});
