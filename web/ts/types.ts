/** Types of the public interface. No code, no imports. */

/** What executes the networks. `auto` takes WebGPU where it is present, correct and faster. */
export type Device = "auto" | "webgpu" | "cpu";

/** What really executes them. */
export type Backend = "webgpu" | "cpu";

/** The engine's builds: `relaxed` computes the networks with the multiply-add of relaxed SIMD, in two thirds of the time. */
export type Build = "plain" | "relaxed";

/** Where bytes come from. A `string` is a URL (under Node also a path). */
export type BytesSource = string | URL | ArrayBuffer | Uint8Array | Blob | ReadableStream<Uint8Array>;

/** Pixels in memory. `stride` is in bytes and defaults to tight rows. */
export interface RawFrame {
  data: Uint8Array | Uint8ClampedArray;
  width: number;
  height: number;
  stride?: number;
  format: "luma8" | "rgb8" | "rgba8";
}

/** One picture. Under Node: `RawFrame` or anything shaped like `ImageData`. */
export type FrameSource =
  | RawFrame
  | ImageData
  | ImageBitmap
  | VideoFrame
  | Blob
  | HTMLCanvasElement
  | OffscreenCanvas
  | HTMLVideoElement
  | HTMLImageElement;

/** Pinhole intrinsics in pixels of a picture of the stated size; corner-based (first pixel's centre is 0.5, 0.5). */
export interface Intrinsics {
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  width: number;
  height: number;
}

/** Where intrinsics that somebody states come from. */
export type KnownIntrinsicsSource =
  /** The caller knows them. */
  | "given"
  /** The camera track's settings. */
  | "track"
  /** The picture's EXIF data. */
  | "exif";

/** How the intrinsics of a result came to be known. */
export type IntrinsicsSource =
  | KnownIntrinsicsSource
  /** Of the camera that took the scene's own pictures: the frame has their shape, and nothing in it contradicts. */
  | "scene"
  /** Learned from earlier frames of the same camera. */
  | "remembered"
  /** Solved from this frame together with the position. */
  | "estimated"
  /** A guess for lack of anything better; distances may be wrong by as much as the guess is. */
  | "assumed";

/** Why there is no position. */
export type NotLocatedReason =
  /** Too little to see: a wall, darkness, blur. */
  | "few-features"
  /** The network is sure of too few features: probably not this place. */
  | "few-correspondences"
  /** No position explains enough of them. */
  | "few-inliers"
  /** What is visible leaves the position open, for example a single flat wall far away. */
  | "degenerate"
  /** Several positions explain the picture equally well. */
  | "ambiguous"
  /** The time budget ran out first. */
  | "timeout"
  /** Hardly anything of what the scene should show is there from any position: another place, or a part that was not taught. */
  | "other-place"
  /** It fits as seen in a mirror: a mirrored picture or camera. Surely told only with `explain`. */
  | "mirrored"
  /** It is located with another focal length than that of the intrinsics that came with it; only with `explain`. */
  | "focal-mismatch"
  /** It is located once it is turned, by `turnClockwiseDeg`; only with `explain`. */
  | "turned";

/** State over several frames. */
export type TrackingState = "searching" | "tracking" | "limited";

/** Why tracking is limited. */
export type LimitedReason = "lost" | "jump" | "focal-uncertain";

/** Where the camera is. Every matrix is 4x4. */
export interface Placement {
  /** Maps world to camera. Row-major; OpenCV camera axes: x right, y down, z forward. */
  cameraFromWorld: Float64Array;
  /** Maps camera to world, the inverse of the above; its last column is the camera's position. Row-major, OpenCV axes. */
  worldFromCamera: Float64Array;
  /** The camera's position in the world. */
  position: { x: number; y: number; z: number };
  /** Rotation part of `worldFromCamera` as a unit quaternion. */
  rotation: { w: number; x: number; y: number; z: number };
  /** For three.js, WebGL, WebXR: column-major; the camera looks along -z, y is up. */
  three: {
    /** The camera's `matrixWorld`. three.js computes it anew from position and rotation: use `applyPlacement` of `landline/three`. */
    worldFromCamera: Float32Array;
    /** Its inverse. */
    cameraFromWorld: Float32Array;
  };
}

/** Which bulk arrays a result carries. They are left out unless asked for, so that frames stay light. */
export type Include = "points" | "lines" | "segments";

/** Keypoints that became correspondences. */
export interface ResultPoints {
  /** x, y per point, pixels of the frame. */
  pixels: Float32Array;
  /** x, y, z per point, world. */
  world: Float32Array;
  /** What the network believes, 0..1. */
  confidence: Float32Array;
  /** 1 where the position explains the point. */
  isInlier: Uint8Array;
}

/** Image segments that became correspondences. */
export interface ResultLines {
  /** x1, y1, x2, y2 per line, pixels of the frame. */
  pixels: Float32Array;
  /** Both ends, six numbers per line, world. */
  world: Float32Array;
  confidence: Float32Array;
  isInlier: Uint8Array;
}

/** Milliseconds per stage of one frame. */
export interface Timings {
  /** Waiting for earlier frames and moving pixels into the engine. */
  transfer: number;
  /** Grey image and resize. */
  preprocess: number;
  /** Extractor network and keypoints. */
  features: number;
  /** Line segments. */
  lines: number;
  /** The scene's two networks. */
  regress: number;
  /** Position from correspondences. */
  solve: number;
  total: number;
}

/**
 * What the world's lengths are: metres, or units of which nobody knows how long they are, as in a reconstruction without a
 * known distance. Only with `metres` may a length be called one.
 */
export type Units = "metres" | "scene-units";

/** What `locate` answers. `located` tells the two kinds apart. */
export type LocateResult = LocatedResult | NotLocatedResult;

/** An answer with a position. */
export interface LocatedResult extends ResultCommon {
  located: true;
  reason?: undefined;
  /** Smoothed when smoothing is on. */
  placement: Placement;
  /** The same before smoothing; present only when smoothing is on. */
  unsmoothed?: Placement;
  /** The frame contradicts the intrinsics that came with it, or were learned before: those of this result are solved ones. */
  warning?: "focal-mismatch";
}

/** An answer without one. */
export interface NotLocatedResult extends ResultCommon {
  located: false;
  reason: NotLocatedReason;
  /** Of the reason `turned`: so the picture has to be turned to be located. */
  turnClockwiseDeg?: 90 | 180 | 270;
  placement?: undefined;
  unsmoothed?: undefined;
}

/** What both kinds of answer have. */
export interface ResultCommon {
  /** Of all lengths and positions in this result. */
  units: Units;
  /** Size of the frame that the pixels of this result refer to. */
  frame: { width: number; height: number };
  /** The frame's time as passed in, else the time of the call. */
  timestampMs: number;
  intrinsics: Intrinsics & { source: IntrinsicsSource; /** Standard deviation of the focal length / focal length. */ relativeSigma?: number };
  quality: {
    keypoints: number;
    segments: number;
    pointCorrespondences: number;
    lineCorrespondences: number;
    pointInliers: number;
    lineInliers: number;
    medianErrorPx: number;
    /**
     * How probably the position is right, 0..1, as far as one frame tells. One that does not bear out its focal length, as before a
     * flat wall, says 0.89 at most.
     */
    confidence: number;
    /** 6x6 row-major: rotation (rad, camera axes) then translation (scene units). */
    covariance?: Float64Array;
    /** Standard deviations that follow from it; `sigmaPosition` in `units`. */
    sigmaPosition?: number;
    sigmaRotationRad?: number;
  };
  state: TrackingState;
  limited?: LimitedReason;
  points?: ResultPoints;
  lines?: ResultLines;
  /** All detected segments, x1, y1, x2, y2. */
  segments?: Float32Array;
  timingsMs: Timings;
  backend: Backend;
  /** Why not a faster one. */
  backendReason: string;
  /** The build of the engine. */
  build: Build;
  /** Why this one. */
  buildReason: string;
}

/** Options of one `locate` call. */
export interface LocateOptions {
  intrinsics?: Intrinsics;
  /** Where they come from; `given` by default. Those of EXIF are taken as a few percent off and refined. */
  intrinsicsSource?: KnownIntrinsicsSource;
  /** Milliseconds; must grow from frame to frame of one camera. */
  timestamp?: number;
  include?: readonly Include[];
  /** Name of the camera for what is remembered about it. Frames without a name share nothing. */
  camera?: string;
  /** Treat the frame as the next one of a moving camera: last position as prior, smoothing, state. */
  tracking?: boolean;
  /** A position that is probably near: a placement, or its `cameraFromWorld`. */
  prior?: Placement | ArrayLike<number>;
  /** Downwards in camera axes (x right, y down, z forward), as `motionSensors()` tells; used where the scene knows its own. */
  gravity?: { x: number; y: number; z: number; /** Standard deviation in radians; two degrees by default. */ sigmaRad?: number };
  /**
   * Find out why a picture is not located: with other intrinsics, in a mirror, and turned by quarters. Such a picture takes up to
   * five times as long; one that is little sure is looked at in a mirror, and takes twice as long. By default for files (`Blob`) that
   * are no frames of a moving camera.
   */
  explain?: boolean;
  /** Hand over `ImageBitmap`, `VideoFrame` or the buffer of raw pixels instead of copying: they are unusable afterwards. */
  transfer?: boolean;
  signal?: AbortSignal;
}

export type Smoothing = "off" | "steady" | "responsive";

/** Options that can be changed at any time. */
export interface LiveOptions {
  smoothing?: Smoothing;
  /** Largest side of the image the engine works on, at most 2048 pixels. The scene's own value is best. */
  maxSide?: number;
  /** Upper limit for the search for a position. */
  timeBudgetMs?: number;
  /** Same seed, same frame, same answer. */
  seed?: number;
  /** Inlier thresholds of the first pose, in pixels of the working image; a second look has its own, in a scene with landmarks. */
  maxPointErrorPx?: number;
  maxLineErrorPx?: number;
}

export interface CreateOptions extends LiveOptions {
  /** A `.landline` file. */
  scene: BytesSource;
  /** Weights of the extractor; those in this package by default. */
  extractor?: BytesSource;
  device?: Device;
  /** The build of the engine: the fastest that the browser can run, by default. Only that one is downloaded. */
  build?: "auto" | Build;
  onProgress?: (event: ProgressEvent) => void;
  signal?: AbortSignal;
  /** The engine; one in this package by default. */
  wasm?: string | URL | ArrayBuffer | Uint8Array | WebAssembly.Module;
  /** Run in a worker. Default: yes in browsers, no under Node. */
  worker?: boolean;
  /** Where the worker's script lies, when a bundler or a strict host needs it elsewhere. */
  workerUrl?: string | URL;
  /**
   * `default`: extractor and scene are kept in the Cache API once the engine has read them. At the next visit the server
   * is asked whether they are still right (`ETag`, `Last-Modified`); without a network the kept ones serve.
   */
  cache?: "default" | "none";
  /** A download of which nothing arrives for so long is given up. Default: 30,000. */
  stallTimeoutMs?: number;
  /** `sha256-<base64>` or 64 hex digits. */
  integrity?: { scene?: string; extractor?: string };
  /** Used for every download. */
  fetch?: typeof fetch;
}

/** Files that are loaded. */
export type LoadedFile = "engine" | "extractor" | "scene" | "place" | "index";

export type ProgressEvent =
  | { status: "download"; file: LoadedFile; url: string; loaded: number; /** 0 when unknown. */ total: number; fromCache: boolean }
  | { status: "done"; file: LoadedFile; bytes: number; fromCache: boolean; /** Kept from an earlier visit, and the server could not be asked whether it is still right. */ unchecked?: true }
  | { status: "prepare" }
  | { status: "ready"; backend: Backend; backendReason: string; build: Build; buildReason: string };

/** Accuracy of a scene on pictures that were not trained on. */
export interface HeldOut {
  pictures: number;
  notLocated: number;
  /** Median distance of the camera positions in `units`; absent where too few pictures were located. */
  medianPosition?: number;
  /** Median angle in degrees; absent as above. */
  medianRotationDeg?: number;
  /** Share within 5 cm and 5 degrees, 0..1; absent unless `units` is `metres`. */
  recall5cm5deg?: number;
}

/** What a scene file says about itself. */
export interface SceneInfo {
  variant: string;
  preset: string;
  extractor: string;
  units: Units;
  licence: string;
  /** ISO 8601 in UTC; empty in files of the first versions of the tool, which did not say. */
  created: string;
  bytes: number;
  /** The camera that the teaching pictures came from, when recorded. */
  camera?: Intrinsics;
  /** Up direction in the world, when known. */
  up?: { x: number; y: number; z: number };
  /** Accuracy on pictures that were not trained on, when it was measured. */
  heldOut?: HeldOut;
  /** Everything in the header, as it stands there. */
  metadata: Record<string, string>;
}

/** Answer of `checkSupport`. */
export interface Support {
  ok: boolean;
  wasmSimd: boolean;
  /** Without it the plain build of the engine is taken. */
  wasmRelaxedSimd: boolean;
  webgpu: boolean;
  worker: boolean;
  camera: boolean;
  secureContext: boolean;
  /** One sentence for everything that is missing. */
  reasons: string[];
}

declare global {
  /** As in `esnext.disposable`, for projects whose `lib` has it not yet. */
  interface SymbolConstructor {
    readonly asyncDispose: unique symbol;
  }
}
