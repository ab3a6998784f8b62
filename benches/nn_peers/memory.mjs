// Peak of the wasm memory for one 640x480 frame through the whole pipeline: XFeat, segments, both branches of the paper's
// network with all 1,024 keypoints kept, and the solver.
//
//   node memory.mjs NN_PEERS.wasm
//
// wasm memory only grows, so its size after the frame is the peak, reading the files included.

import { readFileSync } from "node:fs";

const module = await WebAssembly.compile(readFileSync(process.argv[2]));
const start = async () => (await WebAssembly.instantiate(module, {})).exports;
const size = (engine) => `${(engine.memory.buffer.byteLength / 1e6).toFixed(1)} MB`;

const maker = await start();
maker.make_example_files();
const files = [0, 1].map((which) => new Uint8Array(maker.memory.buffer, maker.example_file(which), maker.example_file_len(which)).slice());

const engine = await start();
console.log(`scene file ${files[0].length} bytes, extractor ${files[1].length} bytes`);
console.log(`empty: ${size(engine)}`);
const put = (bytes) => {
  const at = engine.reserve(bytes.length);
  new Uint8Array(engine.memory.buffer, at, bytes.length).set(bytes);
  return at;
};
engine.pipeline_new(put(files[0]), files[0].length, put(files[1]), files[1].length);
console.log(`pipeline made: ${size(engine)}`);
// Boxes of random grey: many keypoints and segments.
const gray = new Uint8Array(640 * 480);
for (let y = 0; y < 480; y++) for (let x = 0; x < 640; x++) gray[y * 640 + x] = ((x >> 4) * 7919 + (y >> 4) * 104729) % 251;
const at = put(gray);
for (let frame = 1; frame <= 3; frame++) {
  const found = engine.pipeline_locate(at, 640, 480);
  console.log(`frame ${frame}: ${size(engine)} with ${found & 0xffff} keypoints and ${found >> 16} segments`);
}
