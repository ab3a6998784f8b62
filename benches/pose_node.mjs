// Solves the problems of a `.plb` file in WebAssembly under Node; prints one JSON line for each, as the mapper's example `pose_problems` does.
//
//     node benches/pose_node.mjs PACKAGE FILE.plb TAU_POINTS TAU_LINES [REPEAT]
//
// PACKAGE is target/web/bench with landline_bench_bg.wasm and the JavaScript that wasm-bindgen made beside it. The time is
// processor time of the call, median of REPEAT, with the copy of the numbers. benches/pose_peers.py --wasm calls this for every file.
import { existsSync, readFileSync } from "node:fs";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [folder, file, tauPoints, tauLines, repeat = "1"] = process.argv.slice(2);
if (!tauLines) {
  console.error("usage: node pose_node.mjs PACKAGE FILE.plb TAU_POINTS TAU_LINES [REPEAT]");
  process.exit(2);
}
const glue = join(resolve(folder), "landline_bench.js");
if (!existsSync(glue)) {
  console.error(`${glue} is missing: build the package with \`cargo xtask web\``);
  process.exit(2);
}
const landline = await import(pathToFileURL(glue).href);
landline.initSync({ module: readFileSync(join(folder, "landline_bench_bg.wasm")) });

const bytes = readFileSync(file);
const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
let at = 0;
const u32 = () => view.getUint32((at += 4) - 4, true);
const f64 = (n) => Float64Array.from({ length: n }, () => view.getFloat64((at += 8) - 8, true));
if (bytes.toString("latin1", 0, 4) !== "PLB1") {
  console.error(`${file} is not a pose problem file`);
  process.exit(2);
}
at = 4;
const problems = Array.from({ length: u32() }, () => {
  const [width, height, ...params] = f64(6);
  f64(12); // the truth
  const counts = [u32(), u32()];
  // The last number of an item says whether it is an inlier; the solver wants a sigma there, 0 for unknown.
  const [points, lines] = [7, 12].map((stride, k) => {
    const numbers = f64(stride * counts[k]);
    for (let i = stride - 1; i < numbers.length; i += stride) numbers[i] = 0;
    return numbers;
  });
  return { width, height, params, points, lines };
});

const options = Float64Array.of(Number(tauPoints), Number(tauLines));
const solver = new landline.PoseSolver();
const solve = ({ points, lines, width, height, params }) =>
  solver.solve(points, lines, "PINHOLE", width, height, Float64Array.from(params), options);
// The engine compiles hot code a second time: let it finish before the clock counts.
for (const end = performance.now() + 1500; performance.now() < end; ) problems.slice(0, 8).forEach(solve);
problems.forEach((problem, i) => {
  let out;
  const times = Array.from({ length: Number(repeat) }, () => {
    const start = process.cpuUsage();
    out = solve(problem);
    const { user, system } = process.cpuUsage(start);
    return (user + system) / 1e3;
  });
  const ms = times.sort((a, b) => a - b)[times.length >> 1];
  const hasPose = out[1] === 1 && (out[0] === 0 || out[0] === 4);
  const m = out.subarray(2, 18);
  const R = hasPose ? [m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]] : null;
  const t = hasPose ? [m[3], m[7], m[11]] : null;
  console.log(JSON.stringify({ i, R, t, ms, iters: out[26] }));
});
