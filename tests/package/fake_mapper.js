/**
 * Stands in for `landline/mapper` in tests of the page: quick, and it does what `globalThis.fakeMapper` tells it to. It
 * knows nothing of mapping; the scene that it hands out is the sample's. Served in place of the module, never shipped.
 */
const told = () => ({ failAt: undefined, error: undefined, stepMs: 15, everyNth: 1, registeredShare: 0.9, ...globalThis.fakeMapper });
const stages = ["pairs", "matching", "poses", "refine", "points", "lines", "landmarks", "write"];
const wait = (ms) => new Promise((done) => setTimeout(done, ms));
const failed = ({ code, message, hint }) => Object.assign(new Error(message), { code, hint });

export class Mapper {
  keyframes = 0;
  names = [];
  #seen = 0;
  #units = "scene-units";
  #up;
  #scene;
  #map;

  static async create({ onProgress } = {}) {
    onProgress?.({ status: "download", file: "engine", url: "mapper", loaded: 200_000, total: 400_000, fromCache: false });
    await wait(20);
    onProgress?.({ status: "ready", backend: "cpu", backendReason: "" });
    globalThis.mappers = [...(globalThis.mappers ?? []), new Mapper()];
    return globalThis.mappers.at(-1);
  }

  get coverage() {
    return { keyframes: this.keyframes, enough: 40, most: 300 };
  }

  async addFrame(source, { name, keep } = {}) {
    await wait(told().stepMs);
    const bitmap = await createImageBitmap(source);
    const canvas = new OffscreenCanvas(16, 12);
    const context = canvas.getContext("2d");
    context.drawImage(bitmap, 0, 0, 16, 12);
    bitmap.close();
    const { data } = context.getImageData(0, 0, 16, 12);
    if (data.reduce((sum, value, i) => sum + (i % 4 < 3 ? value : 0), 0) / (16 * 12 * 3) < 12) return { kept: false, reason: "too-dark", advice: "more-light" };
    if (told().full <= this.keyframes) return { kept: false, reason: "full" };
    if (!keep && this.#seen++ % told().everyNth !== 0) return { kept: false, reason: "too-similar", advice: "move-sideways" };
    this.names.push(name);
    this.keyframes += 1;
    return { kept: true, keyframe: this.keyframes - 1, keyframes: this.keyframes, ...(this.keyframes > 40 ? { advice: "enough" } : {}) };
  }

  async build({ signal, onProgress } = {}) {
    for (const [i, stage] of stages.entries()) {
      for (let done = 0; done <= 4; done++) {
        signal?.throwIfAborted();
        if (told().failAt === stage) throw failed(told().error);
        onProgress?.({ stage, done, total: 4, share: (5 * i + done) / (5 * stages.length), etaSeconds: (told().stepMs * (5 * (stages.length - i) - done)) / 1000 });
        await wait(told().stepMs);
      }
    }
    if (this.keyframes < 2) throw failed({ code: "not-enough-pictures", message: `too few pictures (${this.keyframes})`, hint: "Film longer." });
    const [scene, { pictures, camera }] = await Promise.all([
      fetch("./scenes/sample/sample.landline").then(async (response) => new Uint8Array(await response.arrayBuffer())),
      fetch("./scenes/sample/sample.json").then((response) => response.json()),
    ]);
    this.#scene = scene;
    this.#map = { pictures, camera };
    return this.#result();
  }

  async write(what) {
    globalThis.written = [...(globalThis.written ?? []), what];
    if (what.scale) this.#units = "metres";
    if (what.up) this.#up = what.up;
    return this.#result();
  }

  async labels() {
    return new TextEncoder().encode("features and tracks");
  }

  #result() {
    const { pictures, camera } = this.#map;
    const posed = Math.max(2, Math.round(told().registeredShare * this.keyframes));
    const poses = pictures.map(({ cam_from_world }) => inverse(cam_from_world.flat()));
    // On a grid of rays of each camera, some metres away; lines along the rows of the grid.
    const seen = poses.flatMap((pose, k) => Array.from({ length: 96 }, (_, i) => at(pose, camera, (i % 12) / 12, Math.floor(i / 12) / 8, 2 + ((7 * i + k) % 10) / 10)));
    const points = Float32Array.from(seen.flat());
    const lines = Float32Array.from(seen.flatMap((point, i) => (i % 12 === 5 ? [...point, ...seen[i + 1]] : [])));
    return {
      scene: this.#scene,
      report: {
        pictures: Array.from({ length: this.keyframes }, (_, keyframe) => {
          const registered = keyframe < posed;
          const common = { keyframe, ...(this.names[keyframe] ? { name: this.names[keyframe] } : {}), registered };
          if (!registered) return { ...common, reason: "nothing-in-common", advice: "It has nothing in common with another picture." };
          const pose = poses[keyframe % poses.length];
          return { ...common, placement: { worldFromCamera: pose, position: { x: pose[3], y: pose[7], z: pose[11] } } };
        }),
        components: 1,
        focal: camera.fx,
        width: camera.width,
        height: camera.height,
        units: this.#units,
        ...(this.#up ? { up: this.#up } : {}),
        points: points.length / 3,
        lines: lines.length / 6,
        medianReprojection: 0.62,
        seconds: 42,
        warnings: told().warnings ?? [],
        cloud: { points, lines },
      },
    };
  }

  async clear() {
    this.keyframes = 0;
    this.names = [];
    this.#seen = 0;
  }

  async dispose() {
    globalThis.disposed = (globalThis.disposed ?? 0) + 1;
  }
}

function inverse(m) {
  const r = [0, 1, 2].map((i) => [m[i], m[4 + i], m[8 + i]]);
  const t = r.map((row) => -(row[0] * m[3] + row[1] * m[7] + row[2] * m[11]));
  return [...r[0], t[0], ...r[1], t[1], ...r[2], t[2], 0, 0, 0, 1];
}

/** What a camera sees at shares of its width and height, so far away. */
function at(m, k, u, v, depth) {
  const p = [((u * k.width - k.cx) / k.fx) * depth, ((v * k.height - k.cy) / k.fy) * depth, depth];
  return [0, 4, 8].map((row) => m[row] * p[0] + m[row + 1] * p[1] + m[row + 2] * p[2] + m[row + 3]);
}
