// Locates the test vectors on this device and says how the poses compare with those of other devices, as a text to share.
import { Relocalizer, checkSupport } from "../vendor/landline/index.js";

/** SHA-256 of numbers or bytes, its beginning. */
async function digest(parts) {
  const bytes = new Uint8Array(await new Blob(parts).arrayBuffer());
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  return [...hash.slice(0, 8)].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Grey pixels of a lossless picture: the same on every device. */
async function pixels(address) {
  const bitmap = await createImageBitmap(await (await fetch(address)).blob());
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  const { data, width, height } = context.getImageData(0, 0, bitmap.width, bitmap.height);
  return { data: data.filter((_, i) => i % 4 === 0), width, height, format: "luma8" };
}

/** Poses of all frames on one device, as lines of the report. */
async function runOn(device, { scene, intrinsics, vectors }, frames) {
  // Processors may differ in relaxed SIMD; the plain build gives the same bits on all of them.
  const relocalizer = await Relocalizer.create({ scene: new URL(scene, import.meta.url), device, cache: "none", build: "plain" });
  const poses = [];
  const off = [];
  let backend = "";
  for (const [i, frame] of frames.entries()) {
    await relocalizer.reset();
    const result = await relocalizer.locate(frame, { intrinsics });
    backend = result.backend;
    if (!result.located) {
      poses.push(new Uint8Array(1));
      off.push(Infinity);
      continue;
    }
    const { cameraFromWorld, position } = result.placement;
    poses.push(cameraFromWorld);
    const [x, y, z] = vectors[i].position;
    off.push(Math.hypot(position.x - x, position.y - y, position.z - z));
  }
  await relocalizer.dispose();
  const worst = Math.max(...off);
  return {
    device: backend,
    located: off.filter(Number.isFinite).length,
    worstCm: 100 * worst,
    offCm: off.map((distance) => 100 * distance),
    digest: await digest(poses),
  };
}

async function report() {
  const vectors = await (await fetch("./vectors.json")).json();
  const frames = await Promise.all(vectors.vectors.map(({ picture }) => pixels(picture)));
  const lines = [
    "Landline conformance, sample room",
    `browser  ${navigator.userAgent}`,
    `pixels   ${await digest(frames.map(({ data }) => data))}`,
  ];
  const runs = [];
  for (const device of (await checkSupport()).webgpu ? ["cpu", "webgpu"] : ["cpu"]) {
    try {
      const run = await runOn(device, vectors, frames);
      runs.push(run);
      lines.push(`${run.device.padEnd(8)} ${run.located} of ${frames.length} located, at most ${run.worstCm.toFixed(2)} cm from the truth, poses ${run.digest}`);
    } catch (error) {
      lines.push(`${device.padEnd(8)} ${error.code ?? error.name}: ${error.message}`);
    }
  }
  return { text: lines.join("\n"), runs, frames };
}

const outcome = await report();
document.querySelector("#report").textContent = outcome.text;
const copy = document.querySelector("#copy");
copy.disabled = false;
copy.addEventListener("click", () => void navigator.clipboard.writeText(outcome.text));
globalThis.conformance = outcome;
