// Times `detectSegments` in WebAssembly under Node and prints JSON: the least milliseconds and the segments.
//
//     node benches/lsd_node.mjs PACKAGE RAW WIDTH HEIGHT REPEAT
//
// PACKAGE is target/web/bench with landline_bench_bg.wasm and the JavaScript that wasm-bindgen made beside it; RAW holds WIDTH x HEIGHT grey
// bytes. benches/lsd_peers.py --wasm calls this for every picture.
import { existsSync, readFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [folder, raw, width, height, repeat] = process.argv.slice(2);
if (!repeat) {
  console.error("usage: node lsd_node.mjs PACKAGE RAW WIDTH HEIGHT REPEAT");
  process.exit(2);
}
const glue = join(resolve(folder), "landline_bench.js");
if (!existsSync(glue)) {
  console.error(`${glue} is missing: build the package with \`cargo xtask web\``);
  process.exit(2);
}
const landline = await import(pathToFileURL(glue).href);
landline.initSync({ module: readFileSync(join(folder, "landline_bench_bg.wasm")) });
const bytes = new Uint8Array(readFileSync(raw));
let least = Infinity;
let segments;
for (let i = 0; i < Number(repeat); i++) {
  const start = performance.now();
  segments = landline.detectSegments(bytes, Number(width), Number(height), Number(width));
  least = Math.min(least, performance.now() - start);
}
console.log(JSON.stringify({ min_ms: least, segments: Array.from(segments) }));
