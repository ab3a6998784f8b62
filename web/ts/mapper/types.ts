/** Types of `landline/mapper`. No code. */
import type { BytesSource, CreateOptions, Intrinsics, Placement, ProgressEvent, Units } from "../types.js";

export interface MapperOptions {
  /** Weights of the extractor; those in this package by default. */
  extractor?: BytesSource;
  onProgress?: (event: ProgressEvent) => void;
  signal?: AbortSignal;
  /** The mapping engine; the one in this package by default. */
  wasm?: CreateOptions["wasm"];
  /** Run in a worker. Default: yes in browsers, no under Node. */
  worker?: boolean;
  /** Where the mapper's worker script lies, when a bundler or a strict host needs it elsewhere. */
  workerUrl?: string | URL;
  cache?: "default" | "none";
  stallTimeoutMs?: number;
  integrity?: { extractor?: string };
  fetch?: typeof fetch;
  /** Largest side of the image that features are taken from. Default: 640. */
  maxSide?: number;
  /** Most keyframes of a film. Default: 300. */
  maxKeyframes?: number;
}

/** A direction or a place. */
export interface Vec3 {
  x: number;
  y: number;
  z: number;
}

export interface FrameOptions {
  /** Milliseconds. */
  timestamp?: number;
  /** Of this frame. Without them, and without EXIF data, the focal length is found out. */
  intrinsics?: Intrinsics;
  /**
   * Where the frame was taken, in metres: a placement, or its `cameraFromWorld`. All frames of a film have one, or none; with
   * intrinsics. Where the pictures contradict them they are adjusted, held by what was given; the report says so.
   */
  pose?: Placement | ArrayLike<number>;
  /** Downwards in camera axes (x right, y down, z forward), as `motionSensors()` tells. */
  gravity?: Vec3;
  name?: string;
  /** It was a keyframe before, of a film that is read in again: similarity and blur are no reasons against it. */
  keep?: boolean;
  /** Hand over `ImageBitmap`, `VideoFrame` or the buffer of raw pixels instead of copying: they are unusable afterwards. */
  transfer?: boolean;
}

/** What whoever films should do. */
export type Advice =
  /** The camera only turns, which shows no depth. */
  | "move-sideways"
  /** Frames are blurred, or share too little with each other. */
  | "slower"
  /** It is dark. */
  | "more-light"
  /** There is enough for a map. */
  | "enough";

/** Why a frame was not kept. */
export type NotKeptReason = "too-similar" | "too-dark" | "blurred" | "too-few-features" | "size-changed" | "full";

/** What became of a frame. `keyframes` is how many there are now. */
export type FrameVerdict =
  | { kept: true; keyframe: number; keyframes: number; advice?: Advice; reason?: undefined }
  | { kept: false; reason: NotKeptReason; keyframes: number; advice?: Advice };

/** What is being done, in this order; "poses" and "refine" take turns. */
export type MapStage = "pairs" | "matching" | "poses" | "refine" | "points" | "lines" | "landmarks" | "write";

export interface MapProgress {
  stage: MapStage;
  /** Of this stage. */
  done: number;
  total: number;
  /** Of everything, 0..1; never goes back. */
  share: number;
  /** Of everything; absent until it can be guessed. */
  etaSeconds?: number;
}

/** A distance that somebody measured, between what two pixels of keyframes show. */
export interface ScaleFrom {
  from: { keyframe: number; x: number; y: number };
  to: { keyframe: number; x: number; y: number };
  metres: number;
}

/** What a scene is to say. */
export interface WriteOptions {
  signal?: AbortSignal;
  onProgress?: (progress: MapProgress) => void;
  name?: string;
  licence?: string;
  /** Makes lengths metres. */
  scale?: ScaleFrom;
  /** Up in the world of the map that is there. */
  up?: Vec3;
}

export type BuildOptions = Omit<WriteOptions, "scale" | "up">;

/** Why a keyframe has no place. */
export type LeftOutReason = "nothing-in-common" | "only-turned" | "too-few-points" | "no-pose" | "other-piece";

export interface MapPicture {
  keyframe: number;
  name?: string;
  timestamp?: number;
  registered: boolean;
  /** Why not. */
  reason?: LeftOutReason;
  /** The same in words, and what helps. */
  advice?: string;
  placement?: Placement;
}

export interface MapReport {
  pictures: MapPicture[];
  /** Where the poses came from, and what was done with given ones: one line for people. */
  poses: string;
  /** Pieces that the film fell into; the map is the largest. */
  components: number;
  /** Focal length in pixels of the frames, whose size is `width` x `height`. */
  focal: number;
  width: number;
  height: number;
  units: Units;
  /** Up in the world, where it is known. */
  up?: Vec3;
  points: number;
  lines: number;
  /** Pixels. */
  medianReprojection: number;
  /** Of `build`. */
  seconds: number;
  warnings: string[];
  /** To be drawn: x, y, z a point; both ends a line. World of the scene. */
  cloud: { points: Float32Array; lines: Float32Array };
}

export interface MapResult {
  /** A `.landline` file. */
  scene: Uint8Array;
  report: MapReport;
}

/** A file that may hold poses. */
export interface PoseFile {
  /** With its folders as far as they are known: of two pictures of one name they tell which is meant. */
  path: string;
  bytes: Uint8Array;
}

export interface KnownPose {
  /** Row-major 4x4; OpenCV's axes: x right, y down, z forward. Lengths are the files'. */
  cameraFromWorld: Float64Array;
  /** Without lens distortion, where the files have a camera. */
  intrinsics?: Intrinsics;
  /** Focal length in pixels, where that is all they have. */
  focal?: number;
}

/** What files say of pictures. */
export interface KnownPoses {
  /** Where poses are from, in words; empty without any. */
  source: string;
  /** Sentences for people about what was chosen and what cannot be used. */
  notes: string[];
  /** For each picture, in the order given. */
  poses: (KnownPose | null)[];
}

/** Options of `readPoses`; each as in `MapperOptions`. */
export type ReadPosesOptions = Pick<MapperOptions, "wasm" | "worker" | "workerUrl" | "fetch" | "signal" | "onProgress" | "stallTimeoutMs">;

/** How far filming has come. */
export interface Coverage {
  keyframes: number;
  /** So many usually do for a room. */
  enough: number;
  most: number;
  /** Frames that were looked at. */
  frames: number;
  /** Of those not kept, how many for which reason. */
  notKept: Partial<Record<NotKeptReason, number>>;
}

export interface MapperEvents {
  /** Every frame. */
  verdict: CustomEvent<FrameVerdict>;
  /** Whenever a frame was kept. */
  coverage: CustomEvent<Coverage>;
}
