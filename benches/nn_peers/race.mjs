// What the timings in wasm share, under Node and in a browser.

export const median = (times) => times.toSorted((a, b) => a - b)[times.length >> 1];

/** Runs the functions in blocks, one after the other, and returns fastest and median of each. Without rest in between, background
 * compilation of one engine would be charged to the other. `clock` gives milliseconds. */
export async function race(runs, clock, rounds) {
  const times = runs.map(() => []);
  const start = clock();
  for (let warm = 0; warm < 5 || clock() - start < 1500; warm++) for (const run of runs) await run();
  for (let round = 0; round < rounds; round += 3) {
    for (const [index, run] of runs.entries()) {
      for (let i = 0; i < 3; i++) {
        const before = clock();
        await run();
        times[index].push(clock() - before);
      }
    }
  }
  return times.map((list) => ({ best: Math.min(...list), median: median(list) }));
}

/** XFeat's dense part at 640x480 in each module of `nn_peers` and in onnxruntime-web; `file(name)` gives bytes of networks.py.
 * Returns name, fastest and median of each, and how far each module is off onnxruntime-web's features, relative to the largest. */
export async function raceXfeat(ort, modules, file, clock, rounds) {
  ort.env.wasm.numThreads = 1;
  const floats = (bytes) => new Float32Array(bytes.slice().buffer);
  const gray = floats(await file("gray.f32"));
  const weights = await file("xfeat.safetensors");
  const onnx = await ort.InferenceSession.create(await file("xfeat.onnx"), { executionProviders: ["wasm"], graphOptimizationLevel: "all" });
  const feed = { [onnx.inputNames[0]]: new ort.Tensor("float32", gray, [1, 1, 480, 640]) };
  const theirs = (await onnx.run(feed))[onnx.outputNames[0]].data;
  const pixels = theirs.length / 64;
  const runs = [];
  const off = [];
  for (const { bytes } of modules) {
    const { instance } = await WebAssembly.instantiate(bytes, {});
    const ours = instance.exports;
    const put = (numbers) => {
      const at = ours.reserve(numbers.byteLength);
      new Uint8Array(ours.memory.buffer, at, numbers.byteLength).set(new Uint8Array(numbers.buffer, numbers.byteOffset, numbers.byteLength));
      return at;
    };
    const network = ours.network_new(0, 640, 480, put(weights), weights.byteLength);
    const at = put(gray);
    ours.run(network, at);
    const mine = new Float32Array(ours.memory.buffer, ours.output(network, 0), theirs.length);
    let largest = 0;
    let worst = 0;
    for (let i = 0; i < theirs.length; i++) {
      largest = Math.max(largest, Math.abs(theirs[i]));
      const difference = Math.abs(theirs[i] - mine[(i % pixels) * 64 + Math.floor(i / pixels)]);
      worst = Number.isNaN(difference) ? Infinity : Math.max(worst, difference);
    }
    off.push(worst / largest);
    runs.push(() => ours.run(network, at));
  }
  const results = await race([...runs, () => onnx.run(feed)], clock, rounds);
  const names = [...modules.map(({ name }) => name), "onnxruntime-web"];
  return results.map((result, index) => ({ name: names[index], off: off[index], ...result }));
}
