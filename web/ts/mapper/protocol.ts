/** Messages between the page and the mapper's worker. */
import type { CallRequest } from "../rpc.js";
import type { MemoryUse, WireFrame } from "../protocol.js";
import type { FrameVerdict, KnownPoses, MapStage, PoseFile, ScaleFrom } from "./types.js";

export interface CreateRequest {
  module: WebAssembly.Module;
  extractor: Uint8Array;
  options: { maxSide?: number; maxKeyframes?: number };
}

export interface AddRequest {
  frame: WireFrame;
  /** Empty, or fx, fy, cx, cy. */
  intrinsics: readonly number[];
  areExact: boolean;
  /** Empty, or `cameraFromWorld`. */
  pose: ArrayLike<number>;
  /** Empty, or a direction in the camera. */
  gravity: readonly number[];
  name: string;
  keep: boolean;
}

/** What the engine's `write` takes. */
export interface SceneRequest {
  name: string;
  licence: string;
  created: string;
  scale?: ScaleFrom;
  up?: readonly [number, number, number];
}

/** What the engine says of a map. */
export interface RawReport {
  pictures: { keyframe: number; registered: boolean; reason?: string; advice?: string }[];
  poses: string;
  components: number;
  focal: number;
  width: number;
  height: number;
  units: string;
  points: number;
  lines: number;
  pairs: number;
  medianReprojection: number;
  warnings: string[];
  up: readonly [number, number, number] | null;
}

export interface Written {
  scene: Uint8Array;
  report: RawReport;
  /** 16 numbers a keyframe. */
  poses: Float64Array;
  points: Float32Array;
  lines: Float32Array;
}

/** What `readPoses` takes; needs no mapper. */
export interface PosesRequest {
  module: WebAssembly.Module;
  pictures: readonly string[];
  files: readonly PoseFile[];
}

export interface Calls {
  create: { request: CreateRequest; reply: null };
  add: { request: AddRequest; reply: FrameVerdict };
  build: { request: null; reply: null };
  write: { request: SceneRequest; reply: Written };
  labels: { request: null; reply: Uint8Array };
  clear: { request: null; reply: null };
  /** Stops `build` and `write`, which reject with the code `aborted`; answered at once. */
  cancel: { request: null; reply: null };
  memory: { request: null; reply: MemoryUse };
  poses: { request: PosesRequest; reply: KnownPoses };
  dispose: { request: null; reply: null };
}

export type CallName = keyof Calls;

export type Request<N extends CallName = CallName> = CallRequest<Calls, N>;

/** Told while `build` and `write` are under way. */
export interface StageEvent {
  stage: MapStage;
  done: number;
  total: number;
}
