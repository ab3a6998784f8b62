/** What this browser offers. */
import type { Support } from "./types.js";

// A module whose only function splats an i32 into a v128 and drops it: it validates exactly where SIMD is understood.
const simdProbe = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 4, 1, 96, 0, 0, 3, 2, 1, 0, 10, 9, 1, 7, 0, 65, 0, 253, 17, 26, 11,
]);

// The same with the one instruction that only the relaxed build has: `f32x4.relaxed_madd` of three vectors.
const relaxedProbe = new Uint8Array([
  0, 97, 115, 109, 1, 0, 0, 0, 1, 4, 1, 96, 0, 0, 3, 2, 1, 0, 10, 20, 1, 18, 0, 65, 0, 253, 17, 65, 0, 253, 17, 65, 0, 253, 17, 253, 133, 2, 26, 11,
]);

export function hasSimd(): boolean {
  return typeof WebAssembly === "object" && WebAssembly.validate(simdProbe);
}

export function hasRelaxedSimd(): boolean {
  return typeof WebAssembly === "object" && WebAssembly.validate(relaxedProbe);
}

/** True where the code runs under Node rather than in a browser or a worker of one. */
export function isNode(): boolean {
  const versions = (globalThis as { process?: { versions?: { node?: string } } }).process?.versions;
  return versions?.node !== undefined && typeof document === "undefined" && typeof importScriptsOfWorker() === "undefined";
}

function importScriptsOfWorker(): unknown {
  return (globalThis as { WorkerGlobalScope?: unknown }).WorkerGlobalScope;
}

/** Tells whether the engine can run here, and what it could use. Loads nothing. */
export async function checkSupport(): Promise<Support> {
  const reasons: string[] = [];
  const wasmSimd = hasSimd();
  if (!wasmSimd) reasons.push("This browser has no WebAssembly SIMD. Chrome 91, Firefox 89 and Safari 16.4 were the first to have it.");
  const wasmRelaxedSimd = hasRelaxedSimd();
  if (wasmSimd && !wasmRelaxedSimd) reasons.push(`${isNode() ? "This Node" : "This browser"} has no relaxed SIMD; the plain build of the engine is used. Chrome 114, Firefox 146 and Safari 27.3 were the first to have it.`);
  const worker = typeof Worker === "function";
  if (!worker && !isNode()) reasons.push("This browser has no module workers; the page will stutter while a picture is processed.");
  const secureContext = isNode() || globalThis.isSecureContext === true;
  if (!secureContext) reasons.push("This page was not loaded over HTTPS: no camera, no WebGPU and no cache.");
  const camera = typeof navigator !== "undefined" && typeof navigator.mediaDevices?.getUserMedia === "function";
  if (!camera && !isNode()) reasons.push("This browser offers no camera to this page; pictures and videos still work.");
  let webgpu = false;
  if (typeof navigator !== "undefined" && "gpu" in navigator && navigator.gpu) {
    try {
      webgpu = (await navigator.gpu.requestAdapter()) !== null;
    } catch {
      webgpu = false;
    }
  }
  if (!webgpu) reasons.push("WebGPU is not available; the CPU is used.");
  return { ok: wasmSimd, wasmSimd, wasmRelaxedSimd, webgpu, worker, camera, secureContext, reasons };
}
