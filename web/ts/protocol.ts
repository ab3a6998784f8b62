/** Messages between the page and the worker. */
import type { CallReply, CallRequest } from "./rpc.js";
import type { Device, Include, Intrinsics, KnownIntrinsicsSource, LiveOptions, LocateResult, RawFrame, SceneInfo, Backend, Build } from "./types.js";

/** Pixels, or something that the worker can draw. */
export type WireFrame = RawFrame | ImageBitmap | VideoFrame;

export interface CreateRequest {
  module: WebAssembly.Module;
  /** The build that was chosen; none where the caller gave the engine. */
  build: Build | undefined;
  buildReason: string;
  extractor: Uint8Array;
  scene: Uint8Array;
  device: Device;
  options: LiveOptions;
}

export interface LocateRequest {
  frame: WireFrame;
  intrinsics?: Intrinsics;
  intrinsicsSource: KnownIntrinsicsSource;
  timestampMs: number;
  include: readonly Include[];
  camera: string;
  tracking: boolean;
  explain: boolean;
  /** Empty, or a direction in the camera and its standard deviation. */
  gravity: readonly number[];
  /** Empty, or `cameraFromWorld`. */
  prior: ArrayLike<number>;
  /** `performance.now()` plus its origin when `locate` was called. */
  calledAt: number;
}

export interface Created {
  scene: SceneInfo;
  backend: Backend;
  backendReason: string;
  build: Build;
  buildReason: string;
}

/** What the engine holds, in bytes. */
export interface MemoryUse {
  wasmBytes: number;
}

export interface Calls {
  create: { request: CreateRequest; reply: Created };
  locate: { request: LocateRequest; reply: LocateResult };
  setOptions: { request: LiveOptions; reply: null };
  recallCamera: { request: { camera: string; focalPerWidth: number }; reply: null };
  reset: { request: null; reply: null };
  memory: { request: null; reply: MemoryUse };
  dispose: { request: null; reply: null };
}

export type CallName = keyof Calls;

export type Request<N extends CallName = CallName> = CallRequest<Calls, N>;

export type Reply = CallReply;
