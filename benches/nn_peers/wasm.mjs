// Times the networks in wasm, one thread, beside onnxruntime-web, in one process and interleaved.
//
//   node wasm.mjs FOLDER NN_PEERS.wasm [--profile] [--rounds N]
//
// FOLDER is what networks.py made. Prints one line per case: fastest and median of each engine in milliseconds of processor
// time, and the ratios (theirs / ours). Processor time, not time of day: it counts only what the process itself used, so
// other programs on the machine cannot push a result either way by more than they disturb the caches.
// Outputs are compared before anything is timed.

import { readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import * as ort from "onnxruntime-web";
import { race as raceBy } from "./race.mjs";

const [folder, wasmPath, ...flags] = process.argv.slice(2);
const rounds = Number(flags[flags.indexOf("--rounds") + 1]) || 30;
ort.env.wasm.numThreads = 1;

const { instance } = await WebAssembly.instantiate(readFileSync(wasmPath), {});
const ours = instance.exports;
const file = (name) => readFileSync(join(folder, name));
const floats = (name) => new Float32Array(new Uint8Array(file(name)).buffer);

function put(bytes) {
  const at = ours.reserve(bytes.byteLength);
  new Uint8Array(ours.memory.buffer, at, bytes.byteLength).set(new Uint8Array(bytes.buffer, bytes.byteOffset, bytes.byteLength));
  return at;
}

function network(kind, weights, width, height) {
  const bytes = file(weights);
  return ours.network_new(kind, width, height, put(bytes), bytes.byteLength);
}

async function session(name, shape, data) {
  const onnx = await ort.InferenceSession.create(new Uint8Array(file(name)), { executionProviders: ["wasm"], graphOptimizationLevel: "all" });
  const input = onnx.inputNames[0];
  const run = () => onnx.run({ [input]: new ort.Tensor("float32", data, shape) });
  return { run, names: onnx.outputNames };
}

// Milliseconds of processor time of this process so far.
function clock() {
  const { user, system } = process.cpuUsage();
  return (user + system) / 1e3;
}

// Largest difference relative to the largest number; theirs is NCHW where `channels` is given, ours NHWC.
function difference(theirs, handle, index, channels) {
  const mine = new Float32Array(ours.memory.buffer, ours.output(handle, index), theirs.length);
  const pixels = channels ? theirs.length / channels : 0;
  let largest = 0;
  let off = 0;
  for (let i = 0; i < theirs.length; i++) {
    const j = channels ? (i % pixels) * channels + Math.floor(i / pixels) : i;
    largest = Math.max(largest, Math.abs(theirs[i]));
    off = Math.max(off, Math.abs(theirs[i] - mine[j]));
  }
  return off / largest;
}

// Leaves an output for native.py, which compares it with the native build's.
function leave(name, handle, index, count) {
  writeFileSync(join(folder, name), new Uint8Array(ours.memory.buffer, ours.output(handle, index), count * 4));
}

const race = (runs) => raceBy(runs, clock, rounds);

function report(name, gflop, result, labels, note = "") {
  const [mine] = result;
  const cells = result.map((r, i) => {
    const rate = gflop ? ` ${(gflop / r.best * 1e3).toFixed(1)} GFLOP/s` : "";
    const ratio = i ? ` x${(r.best / mine.best).toFixed(2)} (median x${(r.median / mine.median).toFixed(2)})` : "";
    return `${labels[i]} ${r.best.toFixed(2)} / ${r.median.toFixed(2)} ms${rate}${ratio}`;
  });
  console.log(`${name}: ${cells.join("; ")}${note}`);
}

function profile(handle, input) {
  const nodes = ours.num_nodes(handle);
  const times = Array.from({ length: nodes }, () => Infinity);
  for (let round = 0; round < 30; round++) {
    ours.run(handle, input);
    for (let node = 0; node < nodes; node++) {
      const before = clock();
      ours.run_node(handle, node);
      times[node] = Math.min(times[node], clock() - before);
    }
  }
  for (let node = 0; node < nodes; node++) {
    const bytes = new Uint8Array(ours.memory.buffer, ours.node_label(handle, node), 60);
    const label = new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
    const macs = ours.node_kilo_macs(handle, node) / 1e3;
    console.log(`  ${label.padEnd(34)} ${times[node].toFixed(3)} ms ${macs.toFixed(1)} MMAC ${(macs * 2 / 1e3 / times[node] * 1e3).toFixed(1)} GFLOP/s`);
  }
  console.log(`  sum ${times.reduce((a, b) => a + b).toFixed(2)} ms`);
}

const wanted = (name) => !flags.some((flag) => flag.startsWith("--only=") && !flag.slice(7).split(",").some((part) => name.includes(part)));

if (wanted("product")) {
  for (const [m, k, n] of [[960, 256, 256], [480, 512, 512], [1024, 256, 1024]]) {
    const a = new Float32Array(m * k).map(() => Math.random() * 2 - 1);
    const at = put(a);
    const mine = ours.product_new(m, k, n, 0);
    const rten = ours.product_new(m, k, n, 1);
    const theirs = await session(`product_${m}_${k}_${n}.onnx`, [m, k], a);
    const result = await race([() => ours.run(mine, at), theirs.run, () => ours.run(rten, 0)]);
    report(`product ${m}x${k}x${n}`, 2 * m * k * n / 1e9, result, ["ours", "onnxruntime-web", "rten-gemm"]);
  }
}
if (wanted("conv")) {
  for (const [h, w, i, o, stride] of [[120, 160, 64, 64, 1], [60, 80, 64, 64, 1], [120, 160, 24, 24, 1]]) {
    const x = new Float32Array(h * w * i).map(() => Math.random());
    const at = put(x);
    const mine = ours.convolution_new(h, w, i, o, stride);
    const theirs = await session(`conv_${h}_${w}_${i}_${o}_${stride}.onnx`, [1, i, h, w], x);
    const result = await race([() => ours.run(mine, at), theirs.run]);
    report(`conv3x3 ${i}-${o} ${w}x${h}`, 2 * 9 * h * w * i * o / 1e9, result, ["ours", "onnxruntime-web"]);
  }
}
if (wanted("xfeat")) {
  const gray = floats("gray.f32");
  const at = put(gray);
  const mine = network(0, "xfeat.safetensors", 640, 480);
  const theirs = await session("xfeat.onnx", [1, 1, 480, 640], gray);
  ours.run(mine, at);
  const out = await theirs.run();
  const [features, heat, reliability] = theirs.names.map((name) => out[name].data);
  const off = [difference(features, mine, 0, 64), difference(heat, mine, 1), difference(reliability, mine, 2)];
  [features, heat, reliability].forEach((data, index) => leave(`wasm_xfeat_${index}.f32`, mine, index, data.length));
  if (flags.includes("--profile")) profile(mine, at);
  report("XFeat 640x480", 2.62, await race([() => ours.run(mine, at), theirs.run]), ["ours", "onnxruntime-web"], `; off by ${off.map((x) => x.toExponential(1))}`);
  console.log(`  memory: weights ${ours.bytes(mine, 0)}, activations ${ours.bytes(mine, 1)}, scratch ${ours.bytes(mine, 2)} bytes`);
}
for (const n of [512, 1024]) {
  if (!wanted(`point${n}`)) continue;
  const descriptors = floats("descriptors.f32").slice(0, n * 256);
  const at = put(descriptors);
  const mine = network(2, "point.safetensors", n, 0);
  const plain = await session(`point_${n}.onnx`, [n, 256], descriptors);
  const folded = await session(`point_${n}_folded.onnx`, [n, 256], descriptors);
  ours.run(mine, at);
  const out = await plain.run();
  const coordinates = out[plain.names[1]].data;
  const off = difference(coordinates, mine, 2);
  leave(`wasm_point_${n}.f32`, mine, 2, coordinates.length);
  if (flags.includes("--profile")) profile(mine, at);
  const result = await race([() => ours.run(mine, at), plain.run, folded.run]);
  report(`point branch, ${n} keypoints`, 0, result, ["ours", "onnxruntime-web", "onnxruntime-web, simplified network"], `; off by ${off.toExponential(1)}`);
  console.log(`  memory: weights ${ours.bytes(mine, 0)}, activations ${ours.bytes(mine, 1)}, scratch ${ours.bytes(mine, 2)} bytes`);
}
console.log(`wasm memory ${(ours.memory.buffer.byteLength / 1e6).toFixed(1)} MB (with the timings' own inputs and weight files)`);
