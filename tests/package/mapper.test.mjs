// `landline/mapper`: a film becomes a scene, the scene locates; what is no film is refused with its reason.
import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { test } from "node:test";
import { pathToFileURL } from "node:url";
import { promisify } from "node:util";
import { installed } from "./support.mjs";
import { camera, centre, distance, pose, render, walk } from "./walk.mjs";

const load = async (t) => {
  const folder = join(await installed(t), "node_modules/landline");
  const at = (name) => import(pathToFileURL(join(folder, name)).href);
  return { ...(await at("mapper/index.js")), ...(await at("index.js")) };
};

const code = (promise) => promise.then(() => "nothing", (error) => error.code ?? error.name);

/** A mapper that has seen a walk; positions of what was kept. */
async function filmed(t, Mapper, count, options = () => ({})) {
  const mapper = await Mapper.create();
  t.after(() => mapper.dispose());
  const kept = [];
  for (const { eye, yaw } of walk(count)) {
    const verdict = await mapper.addFrame(render(eye, yaw), options(eye, yaw));
    if (verdict.kept) kept.push(eye);
  }
  return { mapper, kept };
}

test("a film becomes a scene that locates what it has not seen", { timeout: 240_000 }, async (t) => {
  const { Mapper, Relocalizer } = await load(t);
  // What so short a film says of the focal length depends on where it ends: of 14 frames it is off by 9 to 11 per cent, of 17 by 2 at
  // most, of 20 by 6 to 10.
  const count = 17;
  const { mapper, kept } = await filmed(t, Mapper, count);
  assert.ok(kept.length >= 10, `${kept.length} frames were kept`);
  assert.equal(mapper.keyframes, kept.length);
  const still = walk(count).at(-1);
  assert.equal((await mapper.addFrame(render(still.eye, still.yaw))).reason, "too-similar");

  const told = [];
  const { scene, report } = await mapper.build({ onProgress: (progress) => told.push(progress) });
  assert.ok(report.pictures.filter((p) => p.registered).length >= 0.75 * kept.length, JSON.stringify(report.warnings));
  assert.equal(report.units, "scene-units");
  assert.ok(Math.abs(report.focal / camera.fx - 1) < 0.1, `focal length ${report.focal}`);
  assert.ok(told.every((p, i) => i === 0 || p.share >= told[i - 1].share), "progress never goes back");
  assert.deepEqual([...new Set(told.map((p) => p.stage))].filter((s) => s !== "refine"), ["pairs", "matching", "poses", "points", "lines", "landmarks"]);

  // The film's unit is free: what is known is the way between the first and the last frame.
  const places = report.pictures.map((p) => p.placement && [p.placement.position.x, p.placement.position.y, p.placement.position.z]);
  const [first, last] = [places.findIndex(Boolean), places.findLastIndex(Boolean)];
  const metres = distance(kept[first], kept[last]) / distance(places[first], places[last]);
  for (const [i, place] of places.entries()) {
    if (place) assert.ok(Math.abs(metres * distance(place, places[first]) - distance(kept[i], kept[first])) < 0.06, `frame ${i}`);
  }

  const relocalizer = await Relocalizer.create({ scene, device: "cpu" });
  t.after(() => relocalizer.dispose());
  const asked = walk(27).filter((_, i) => i % 6 === 3);
  for (const { eye, yaw } of asked) {
    const found = await relocalizer.locate(render(eye, yaw));
    assert.ok(found.located, `${found.reason}`);
    const place = centre(found.placement.cameraFromWorld);
    const off = Math.abs(metres * distance(place, places[first]) - distance(eye, kept[first]));
    t.diagnostic(`located ${(100 * off).toFixed(1)} cm off, seen from the first frame`);
    assert.ok(off < 0.06, `${off} m`);
  }

  // A metre stick: two corners of the same picture whose distance is known from the map itself.
  const [a, b] = [{ keyframe: first, x: 90, y: 110 }, { keyframe: first, x: 230, y: 120 }];
  assert.match(report.poses, /from the pictures alone/);
  const labels = await mapper.labels();
  const header = JSON.parse(new TextDecoder().decode(labels.subarray(8, 8 + Number(new DataView(labels.buffer).getBigUint64(0, true)))));
  assert.equal(header.__metadata__.format, "landline labels 3");
  assert.equal(header.points.shape[0], report.points);
  const once = await mapper.write({ scale: { from: a, to: b, metres: 1 }, up: { x: 0, y: -1, z: 0 } });
  const twice = await mapper.write({ scale: { from: a, to: b, metres: 2 } });
  assert.equal(once.report.units, "metres");
  assert.deepEqual(once.report.up, { x: 0, y: -1, z: 0 });
  const length = ({ report: { pictures } }) => distance(...[first, last].map((i) => Object.values(pictures[i].placement.position)));
  assert.ok(Math.abs(length(twice) / length(once) - 2) < 1e-9);
  for (const metres of [1e-9, 1e9]) assert.equal(await code(mapper.write({ scale: { from: a, to: b, metres } })), "bad-input");
  assert.equal(await code(mapper.write({ scale: { from: a, to: { ...a, x: a.x + 0.1 }, metres: 1 } })), "bad-input", "one place twice");
  const broken = new Error("the page's own");
  const refused = await mapper.write({ onProgress: () => { throw broken; } }).catch((e) => e);
  assert.equal(refused, broken);
  assert.equal((await mapper.write()).report.units, "metres", "the map is as it was");
  assert.equal(await code(mapper.write({ scale: { from: { keyframe: 999, x: 1, y: 1 }, to: b, metres: 1 } })), "bad-input");
});

test("with poses given, the map is in their world", { timeout: 120_000 }, async (t) => {
  const { Mapper } = await load(t);
  const { mapper } = await filmed(t, Mapper, 8, (eye, yaw) => ({ pose: pose(eye, yaw), intrinsics: camera }));
  const { report } = await mapper.build();
  assert.equal(report.units, "metres");
  assert.match(report.poses, /^as given\b.* matches lie \d\.\d\d /);
  assert.ok(report.points > 100 && report.medianReprojection < 1.5, JSON.stringify(report.medianReprojection));
  // What is seen lies on the walls and boxes: none of it outside of the room.
  const { points } = report.cloud;
  const places = Array.from({ length: points.length / 3 }, (_, i) => points.subarray(3 * i, 3 * i + 3));
  const inside = places.filter(([x, y, z]) => Math.abs(x) < 3.15 && y > -1.55 && y < 1.35 && z < 3.65).length;
  assert.ok(inside > 0.92 * places.length, `${inside} of ${places.length}`);
});

test("what is no film is refused with its reason", { timeout: 240_000 }, async (t) => {
  const { Mapper } = await load(t);
  const mapper = await Mapper.create();
  t.after(() => mapper.dispose());
  const [start] = walk(2);
  assert.equal(await code(mapper.build()), "not-enough-pictures");
  const dark = await mapper.addFrame(render(start.eye, start.yaw, 0.05));
  assert.deepEqual([dark.kept, dark.reason, dark.advice], [false, "too-dark", "more-light"]);
  assert.equal((await mapper.addFrame({ data: new Uint8Array(320 * 240).fill(120), width: 320, height: 240, format: "luma8" })).reason, "too-few-features");
  // Turned on the spot: shows no depth.
  for (let i = 0; i < 8; i++) await mapper.addFrame(render(start.eye, 0.25 - 0.08 * i));
  assert.ok(mapper.keyframes >= 5, `${mapper.keyframes} keyframes`);
  const error = await mapper.build().catch((e) => e);
  assert.equal(error.code, "no-model", error.message);
  assert.match(error.message, /turn/);
  assert.equal((await mapper.addFrame({ data: new Uint8Array(240 * 320), width: 240, height: 320, format: "luma8" })).reason, "size-changed");
  assert.equal(mapper.coverage.notKept["too-dark"], 1);
  await mapper.clear();
  assert.equal(mapper.keyframes, 0);

  assert.equal(await code(mapper.addFrame(render(start.eye, 0), { pose: pose(start.eye, 0) })), "bad-input");
  assert.equal(await code(mapper.addFrame(render(start.eye, 0), { pose: [1, 2, 3] })), "bad-input");
  assert.equal(await code(mapper.addFrame(render(start.eye, 0), { when: 3 })), "bad-input");
  // All frames have poses, or none.
  await mapper.addFrame(render(start.eye, 0));
  const posed = await mapper.addFrame(render(start.eye, 0.2), { pose: pose(start.eye, 0.2), intrinsics: camera }).catch((e) => e);
  assert.deepEqual([posed.code, posed.message], ["bad-input", "this frame has a pose, those before it have none"]);
  assert.equal(await code(mapper.write()), "bad-input");
  assert.equal(await code(Mapper.create({ maxKeyframes: 1 })), "bad-input");
  assert.equal(await code(Mapper.create({ extractor: new Uint8Array(100) })), "extractor-corrupt");
  await mapper.dispose();
  assert.equal(await code(mapper.build()), "disposed");
});

test("a build can be cancelled at every stage, and made again", { timeout: 240_000 }, async (t) => {
  const { Mapper } = await load(t);
  const { mapper } = await filmed(t, Mapper, 7);
  for (const stage of ["pairs", "matching", "poses", "refine", "points", "lines", "landmarks"]) {
    const stop = new AbortController();
    const build = mapper.build({ signal: stop.signal, onProgress: (p) => p.stage === stage && stop.abort(new Error(`at ${stage}`)) });
    await assert.rejects(build, { message: `at ${stage}` });
  }
  const built = mapper.build();
  await assert.rejects(mapper.addFrame({ data: new Uint8Array(64 * 64), width: 64, height: 64, format: "luma8" }), { code: "bad-input", message: /being made/ });
  await assert.rejects(mapper.clear(), { code: "bad-input" });
  const { report } = await built;
  assert.ok(report.points > 100);
});

/** The engine with at most so many pages of memory. */
function limited(bytes, pages) {
  const leb = (n) => (n < 128 ? [n] : [(n & 127) | 128, ...leb(n >>> 7)]);
  let at = 8;
  const number = () => {
    let [value, shift] = [0, 0];
    for (;;) {
      const byte = bytes[at++];
      value |= (byte & 127) << shift;
      if (byte < 128) return value;
      shift += 7;
    }
  };
  for (;;) {
    const start = at;
    const id = bytes[at++];
    const size = number();
    if (id === 5) {
      const end = at + size;
      at += 2; // one memory, and whether it has a limit
      const section = [1, 1, ...leb(number()), ...leb(pages)];
      return Buffer.concat([bytes.subarray(0, start), Buffer.from([5, ...leb(section.length), ...section]), bytes.subarray(end)]);
    }
    at += size;
  }
}

test("a device that gives no more memory is named, and the engine says so from then on", { timeout: 120_000 }, async (t) => {
  const folder = join(await installed(t), "node_modules/landline/mapper");
  const wasm = await readFile(join(folder, "landline_mapper_bg.wasm"));
  // An engine is shared by a whole thread, hence a process for each limit.
  const script = `
    const { Mapper } = await import(${JSON.stringify(pathToFileURL(join(folder, "index.js")).href)});
    const wasm = process.env.WASM_FILE && await (await import("node:fs/promises")).readFile(process.env.WASM_FILE);
    const mapper = await Mapper.create(wasm ? { wasm } : {});
    const { wasmBytes } = await mapper.memory();
    const frame = { data: new Uint8Array(640 * 480).map((_, i) => (i * 7919) % 251), width: 640, height: 480, format: "luma8" };
    const codes = [];
    for (let i = 0; i < 2 && process.env.WASM_FILE; i++) codes.push(await mapper.addFrame(frame).then(() => "nothing", ({ code }) => code));
    console.log(JSON.stringify({ wasmBytes, codes }));
  `;
  const run = async (environment) => JSON.parse((await promisify(execFile)(process.execPath, ["--input-type=module", "-e", script], { env: { ...process.env, ...environment } })).stdout);
  const { wasmBytes } = await run({ WASM_FILE: "" });
  const file = join(folder, "limited.wasm");
  await writeFile(file, limited(wasm, wasmBytes / 65536 + 16));
  const { codes } = await run({ WASM_FILE: file });
  assert.deepEqual(codes, ["out-of-memory", "out-of-memory"]);
});
