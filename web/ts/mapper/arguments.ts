/** Arguments of the mapper's calls, checked where they enter. */
import { abortSignal, checkArgument, checkOptions, intrinsics, kind, loading, number, object, whole, type Check } from "../arguments.js";
import type { BuildOptions, FrameOptions, MapperOptions, ReadPosesOptions, WriteOptions } from "./types.js";

const largest = Number.MAX_VALUE;
const isNumber = number(-largest, largest, "");
const vector: Check = (value) => {
  const v = value as { x?: unknown; y?: unknown; z?: unknown } | null;
  return typeof v === "object" && v && ![v.x, v.y, v.z].some((n) => isNumber(n) !== undefined) ? undefined : "{ x, y, z } of finite numbers";
};
const end = (value: unknown): boolean => {
  const v = value as { keyframe?: unknown; x?: unknown; y?: unknown } | null;
  return typeof v === "object" && v !== null && Number.isInteger(v.keyframe) && (v.keyframe as number) >= 0 && isNumber(v.x) === undefined && isNumber(v.y) === undefined;
};
/** The distance is checked again where it is used: DISTANCES_M of src/mapping/recorder.rs. */
const scale: Check = (value) => {
  const v = value as { from?: unknown; to?: unknown; metres?: unknown } | null;
  const isRight = typeof v === "object" && v !== null && end(v.from) && end(v.to) && typeof v.metres === "number" && v.metres >= 1e-3 && v.metres <= 1e5;
  return isRight ? undefined : "{ from: { keyframe, x, y }, to: { keyframe, x, y }, metres: from 0.001 to 100000 }";
};

const create: Record<keyof MapperOptions, Check> = {
  ...loading,
  maxSide: whole(32, 2048, "a whole number of pixels from 32 to 2048"),
  maxKeyframes: whole(3, 500, "a whole number from 3 to 500"),
};

const add: Record<keyof FrameOptions, Check> = {
  timestamp: number(-largest, largest, "a finite number of milliseconds"),
  intrinsics,
  pose: object,
  gravity: vector,
  name: kind("string"),
  keep: kind("boolean"),
  transfer: kind("boolean"),
};

const build: Record<keyof BuildOptions, Check> = {
  signal: abortSignal,
  onProgress: kind("function"),
  name: kind("string"),
  licence: kind("string"),
};

const { onProgress, signal, wasm, worker, workerUrl, stallTimeoutMs, fetch } = loading;
const poses: Record<keyof ReadPosesOptions, Check> = { onProgress, signal, wasm, worker, workerUrl, stallTimeoutMs, fetch };
const isFile = (value: unknown): boolean => {
  const v = value as { path?: unknown; bytes?: unknown } | null;
  return typeof v === "object" && v !== null && typeof v.path === "string" && v.bytes instanceof Uint8Array;
};
const paths: Check = (value) => (Array.isArray(value) && value.every((path) => typeof path === "string") ? undefined : "a list of paths");
const files: Check = (value) => (Array.isArray(value) && value.every(isFile) ? undefined : "a list of { path, bytes: Uint8Array }");

const write: Record<keyof WriteOptions, Check> = { ...build, scale, up: vector };

export const checkMapperOptions = (options: unknown): void => checkOptions("create", options, create);
export const checkFrameOptions = (options: unknown): void => checkOptions("addFrame", options, add);
export const checkBuildOptions = (options: unknown): void => checkOptions("build", options, build);
export const checkWriteOptions = (options: unknown): void => checkOptions("write", options, write);

/** What `readPoses` takes. */
export function checkPoses(pictures: unknown, poseFiles: unknown, options: unknown): void {
  checkArgument("pictures", pictures, paths);
  checkArgument("files", poseFiles, files);
  checkOptions("readPoses", options, poses);
}
