// Public declarations of the npm package, as built. Made by `cargo xtask api --bless`; not written by hand.

// ---- adapters/babylon.d.ts

/**
 * Puts a result into Babylon.js. Optional entry `landline/babylon`; nothing of Babylon is imported.
 *
 * The scene must be right-handed (`scene.useRightHandedSystem = true`): the world is.
 */
import { type Intrinsics, type Placement, type View } from "../index.js";
/** What is needed of a `Matrix`. */
interface MatrixLike {
    copyFromFloats?: unknown;
}
/** What is needed of a `TargetCamera` (free and universal cameras are some). */
interface CameraLike<M extends MatrixLike> {
    minZ: number;
    maxZ: number;
    position: {
        set(x: number, y: number, z: number): unknown;
    };
    updateUpVectorFromRotation: boolean;
    rotationQuaternion: {
        set(x: number, y: number, z: number, w: number): unknown;
    } | null;
    freezeProjectionMatrix(projection?: M): void;
}
/** Moves a camera to where the real one is. Give it a `rotationQuaternion` before. */
export declare function applyPlacement<M extends MatrixLike>(camera: CameraLike<M>, { position, rotation }: Placement): void;
/** Gives a camera the real one's field of view in a canvas of any shape. `fromArray` is `Matrix.FromArray`. */
export declare function applyView<M extends MatrixLike>(camera: CameraLike<M>, intrinsics: Intrinsics, view: View, fromArray: (numbers: number[]) => M): void;
export {};

// ---- adapters/three.d.ts

/**
 * Puts a result into three.js. Optional entry `landline/three`; three itself is only needed for its types.
 *
 * three's cameras look along -z with y up, the engine's along +z with y down. The result already carries both forms;
 * this applies them.
 */
import type { Camera as ThreeCamera, PerspectiveCamera, WebGLRenderer } from "three";
import { projectionMatrix, type Fit, type Intrinsics, type Placement, type View } from "../index.js";
export { projectionMatrix };
/**
 * Moves a camera to where the real one is, wherever in the scene graph it hangs. Its matrix is set as a whole:
 * `matrixAutoUpdate` is turned off, and stays right when the renderer updates it.
 */
export declare function applyPlacement(camera: ThreeCamera, placement: Placement): void;
/** Gives a camera the real one's field of view. Draw into a viewport with the frame's aspect ratio, or see `applyView`. */
export declare function applyIntrinsics(camera: PerspectiveCamera, intrinsics: Intrinsics, near?: number, far?: number): void;
/** As `applyIntrinsics`, for a canvas of any shape in which the frame is shown by `view.fit`. */
export declare function applyView(camera: PerspectiveCamera, intrinsics: Intrinsics, view: View, near?: number, far?: number): void;
export interface CameraViewOptions {
    /** How the frame fills the canvas; `cover` by default. */
    fit?: Fit;
    /** For a camera that faces the user: the canvas is mirrored by CSS, as the video should be. */
    mirrored?: boolean;
}
/** What a camera view takes: any result with or without a position. */
interface Seen {
    located: boolean;
    placement?: Placement;
    intrinsics?: Intrinsics;
}
/** Keeps a renderer's size and a camera in step with the results: resized canvas, device pixel ratio, turned phone. */
export declare class CameraView {
    #private;
    constructor(renderer: WebGLRenderer, camera: PerspectiveCamera, options?: CameraViewOptions);
    /** Call with every result before drawing. False when there is no position: draw nothing then. */
    update({ located, placement, intrinsics }: Seen): boolean;
}

// ---- adapters/webxr.d.ts

/**
 * Joins a scene with a WebXR session: one localisation says where the scene lies in the session's space, the device's own
 * tracking does the rest. Optional entry `landline/webxr`.
 */
import { type Placement } from "../index.js";
/** What is needed of an `XRFrame`; the one of the picture that was located. */
interface FrameLike {
    getViewerPose(space: XRSpaceLike): {
        readonly transform: {
            readonly matrix: Float32Array;
        };
    } | undefined;
}
/** What is needed of an `XRReferenceSpace`: nothing. */
type XRSpaceLike = object;
export interface Alignment {
    /** Scene to session space, column-major, metres: the matrix of a group that holds all content of the scene. */
    readonly sessionFromScene: Float32Array;
    /** Answers that went into it. */
    readonly count: number;
}
export interface AlignOptions {
    /** Metres for a unit of the scene; 1 by default. */
    metresPerUnit?: number;
    /** An earlier alignment that is refined: answers are averaged. */
    before?: Alignment;
    /** An answer further than this from the alignment before starts a new one, in metres; 0.5 by default. */
    maxShift?: number;
}
/**
 * Where the scene lies in the session's space. `frame` must be the `XRFrame` of the picture that was located, `result` its
 * answer; the viewer of a phone is its camera. `undefined` while the device does not know its own pose.
 */
export declare function alignSession(frame: FrameLike, space: XRSpaceLike, result: {
    located: boolean;
    placement?: Placement;
}, options?: AlignOptions): Alignment | undefined;
export {};

// ---- assets.d.ts

import type { BytesSource, LoadedFile, ProgressEvent } from "./types.js";
/** A download of which nothing arrives for so long is given up, when the caller does not say. */
export declare const usualStallMs = 30000;
/** The most bytes of a file, announced or not; that of scenes and weights is the format's own limit. */
export declare const maxBytes: Readonly<Record<LoadedFile, number>>;
export interface LoadOptions {
    file: LoadedFile;
    onProgress?: ((event: ProgressEvent) => void) | undefined;
    signal?: AbortSignal | undefined;
    cache?: "default" | "none" | undefined;
    integrity?: string | undefined;
    fetch?: typeof fetch | undefined;
    stallTimeoutMs?: number | undefined;
}
/** A file, and what its reader says of it. */
export interface Loaded {
    bytes: Uint8Array;
    /** Kept from an earlier visit: when it proves to be wrong, a new copy may be right. */
    fromCache: boolean;
    /** It is what it should be: keeps it for the next visit. */
    keep(): Promise<void>;
    /** It is not: forgets it. */
    drop(): Promise<void>;
}
/** SHA-256 as 64 hex digits; `null` where the browser gives no access to it (pages without HTTPS). */
export declare function sha256(bytes: Uint8Array): Promise<string | null>;
/** Accepts 64 hex digits or the `sha256-<base64>` form of subresource integrity. */
export declare function checksumAsHex(integrity: string): string;
/** Loads bytes from whatever the caller has. The answer is never a view into the caller's own buffer. */
export declare function load(source: BytesSource, options: LoadOptions): Promise<Loaded>;
/** True when the file at this address is in the cache. */
export declare function isCached(url: string | URL): Promise<boolean>;
/** Removes everything that this package has stored on the device. */
export declare function clearCache(): Promise<void>;

// ---- builds.d.ts

import type { Build, CreateOptions } from "./types.js";
export interface Choice {
    build: Build;
    /** Why this one, as results tell it. */
    reason: string;
}
/** The build that was asked for, or the fastest that runs here. */
export declare function chooseBuild(asked?: CreateOptions["build"]): Choice;
/** Where a build of the engine lies in this package; by default the one that is taken here. */
export declare function packagedWasmUrl(build?: Build): URL;

// ---- camera.d.ts

import type { Intrinsics } from "./types.js";
/** Which way a camera looks: away from the user, or at the user. */
export type Facing = "environment" | "user";
export interface CameraOptions {
    /** Ask for this device, one of `cameras()`. */
    deviceId?: string;
    /** Otherwise the one that looks this way, `environment` by default. */
    facing?: Facing;
    /** What to ask for; the camera may give something else. */
    width?: number;
    height?: number;
    /** Gives up waiting for the user's answer; a camera that is opened all the same is closed at once. */
    signal?: AbortSignal;
}
/** A camera that could be opened. */
export interface CameraDevice {
    deviceId: string;
    /** Its name; browsers tell it only while or after a camera was allowed, and "Camera 1" stands for it until then. */
    label: string;
}
export interface Camera {
    /** Another one after `flip()`. */
    readonly stream: MediaStream;
    /** Playing; not part of the page unless you add it. The same after `flip()`. */
    readonly video: HTMLVideoElement;
    /** Changes when the lens or the size changes: key for what is remembered about the focal length. */
    key(): string;
    /** Goes over to the camera on the other side, or to the next one where sides are not known. The old one stays where that fails. */
    flip(): Promise<void>;
    /** Switches the light; false where there is none. */
    torch(on: boolean): Promise<boolean>;
    /** Stops the camera. */
    stop(): void;
}
/** The cameras of this device. */
export declare function cameras(): Promise<CameraDevice[]>;
/** Opens a camera. Call it from a click or a tap: browsers ask the user. */
export declare function camera(given?: CameraOptions): Promise<Camera>;
/** Intrinsics from the track's settings, in the form of the W3C proposal; no browser fills them in yet. */
export declare function intrinsicsFromTrack(track: MediaStreamTrack | undefined): Intrinsics | undefined;

// ---- errors.d.ts

/** Everything that can go wrong, as stable codes. "No position found" is not among them: that is a result. */
export type LandlineErrorCode = 
/** The browser lacks something that is needed; `message` says what. */
"unsupported"
/** A file could not be loaded: network, HTTP status, or the server sent a web page instead. */
 | "asset-fetch"
/** The engine's wasm file arrived, but is not wasm. */
 | "asset-mime"
/** A file differs from the checksum that was asked for. */
 | "asset-integrity"
/** The scene file was written for a newer or unknown version of the format. */
 | "scene-version"
/** The scene file is damaged, cut short, or no scene file at all. */
 | "scene-corrupt"
/** The scene was taught on descriptors of another extractor. */
 | "scene-extractor"
/** The extractor's weights are damaged or of another network. */
 | "extractor-corrupt"
/** Memory could not be had. */
 | "out-of-memory"
/** An argument makes no sense; `message` names it and its value. */
 | "bad-input"
/** The camera is not there, busy, or not allowed. */
 | "camera-unavailable" | "camera-denied" | "camera-busy" | "camera-insecure"
/** The engine's wasm file and these scripts are of different versions. */
 | "engine-version"
/** A defect inside the engine: it stopped, or contradicted itself. This instance cannot go on; create a new one. */
 | "engine-defect"
/** `dispose()` was called before or during this call. */
 | "disposed"
/** A map needs more pictures. */
 | "not-enough-pictures"
/** The pictures make no map; `message` says why: no movement, too little in common, nothing but a wall. */
 | "no-model"
/** Cancelled by a call; by a signal, calls reject with the signal's own reason. */
 | "aborted";
/** Every error that this package raises itself. Cancelling by a signal rejects with the signal's own reason. */
export declare class LandlineError extends Error {
    readonly name = "LandlineError";
    /** Stable; made for `switch`. */
    readonly code: LandlineErrorCode;
    /** What the reader can do about it; never empty. */
    readonly hint: string;
    constructor(code: LandlineErrorCode, message: string, hint?: string, cause?: unknown);
}
/** The fields of an error that survive a trip between threads. */
export interface PlainError {
    code: string;
    message: string;
    hint: string;
}
/** Makes a `LandlineError` from anything thrown by the engine or the other thread. */
export declare function asLandlineError(thrown: unknown): LandlineError;
/** The opposite of `asLandlineError`, for messages between threads. */
export declare function plainError(thrown: unknown): PlainError;

// ---- exif.d.ts

/**
 * Focal length from a JPEG's EXIF block.
 *
 * Source: the EXIF 2.3 standard, tags 0xA405 (FocalLengthIn35mmFilm) and 0x8769 (pointer to the EXIF directory).
 * The 35 mm frame has a diagonal of 43.27 mm, so the focal length in pixels is f35 / 43.27 of the picture's diagonal.
 */
/** EXIF stands in the first segments; more than this is never needed. */
export declare const exifBytes: number;
/** 35 mm equivalent focal length in millimetres, or `null` when the bytes do not say. */
export declare function focalLength35mm(bytes: Uint8Array): number | null;
/** Focal length in pixels of a picture of the given size. */
export declare function focalPxFrom35mm(focal35mm: number, width: number, height: number): number;

// ---- follow.d.ts

import { type AnswerUse, type LostFrame, type TrackedFrame } from "./follower.js";
import type { Relocalizer } from "./relocalizer.js";
import type { MotionSensors } from "./sensors.js";
import type { Include, Intrinsics, LocateResult } from "./types.js";
/** The picture of one frame. */
export interface FollowedFrame {
    /** Of the video's picture, in pixels. */
    readonly width: number;
    readonly height: number;
    /** The picture itself, until the next frame's result; anything that draws takes it. */
    readonly source: CanvasImageSource;
    /** Draws it, over the whole canvas when no place is given. */
    draw(context: CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D, x?: number, y?: number, width?: number, height?: number): void;
    /** A copy that may be kept; close it after use. */
    bitmap(): Promise<ImageBitmap>;
}
interface Pictured {
    /** The picture that the position belongs to. */
    frame: FollowedFrame;
    /** Of the newest answer, scaled to the video's picture; absent before the first. */
    intrinsics?: Intrinsics;
    /** Milliseconds that this frame took on this thread. */
    trackingMs: number;
}
/** Result of one frame; `located` tells the two kinds apart. */
export type FollowResult = (TrackedFrame & Pictured & {
    intrinsics: Intrinsics;
}) | (LostFrame & Pictured);
/** An answer of the relocalizer, with what became of it. */
export interface FollowedAnswer {
    result: LocateResult;
    /** The located picture, until the event ends. */
    frame: FollowedFrame;
    use: AnswerUse;
}
export interface FollowEvents {
    /** Every frame. */
    result: CustomEvent<FollowResult>;
    /** The first frame with a position after some without. */
    found: CustomEvent<FollowResult>;
    /** The first frame without one. */
    lost: CustomEvent<FollowResult>;
    /** What limits following has changed; `detail.limited` is absent when nothing does any more. */
    limited: CustomEvent<FollowResult>;
    /** An answer has changed the position: `detail.correction`. */
    corrected: CustomEvent<FollowResult>;
    /** Every answer of the relocalizer. */
    answer: CustomEvent<FollowedAnswer>;
    /**
     * What went wrong; the same message once, not with every frame. Where nobody listens it goes to the console, but for `disposed`:
     * the relocalizer is gone, and the loop has ended.
     */
    error: CustomEvent<unknown>;
}
export interface FollowOptions {
    intrinsics?: Intrinsics;
    include?: readonly Include[];
    camera?: string | (() => string);
    /** Frames a second at most; fewer keep a phone cool. */
    maxFps?: number;
    /** Answers of the relocalizer a second at most. */
    maxLocalizationsPerSecond?: number;
    /** Milliseconds over which a correction fades in; 150 by default. */
    blendMs?: number;
    /** Helps through fast turns. */
    sensors?: MotionSensors;
    onResult?: (result: FollowResult) => void;
    onAnswer?: (answer: FollowedAnswer) => void;
    onError?: (error: unknown) => void;
}
/** A running loop. */
export interface Following extends Omit<EventTarget, "addEventListener" | "removeEventListener"> {
    /** Frames that were not looked at because the thread was busy or `maxFps` says so. */
    readonly dropped: number;
    /** Frames with a result. */
    readonly processed: number;
    /** Answers of the relocalizer. */
    readonly answered: number;
    stop(): void;
    addEventListener<K extends keyof FollowEvents>(type: K, listener: (event: FollowEvents[K]) => void, options?: boolean | AddEventListenerOptions): void;
    removeEventListener<K extends keyof FollowEvents>(type: K, listener: (event: FollowEvents[K]) => void, options?: boolean | EventListenerOptions): void;
}
/** What gives the answers: a relocalizer, or a place of many rooms. */
export interface Locator extends Pick<Relocalizer, "backend" | "follower"> {
    locate(...call: Parameters<Relocalizer["locate"]>): Promise<LocateResult & {
        room?: {
            id: string;
        };
    }>;
}
/**
 * Gives a position for every frame of a playing video, tracked between the answers of the relocalizer; pauses while the page is
 * hidden. Tracking runs on this thread, so that the result comes in the very callback in which the frame is shown.
 */
export declare function follow(relocalizer: Locator, video: HTMLVideoElement, options?: FollowOptions): Following;
export {};

// ---- follower.d.ts

import type { CreateOptions, LocateResult, Placement } from "./types.js";
export type FollowState = "searching" | "tracking" | "limited";
/** Why following is limited. */
export type FollowLimit = 
/** The camera moves too fast. */
"excessive-motion"
/** Too little to see, or something is in front of the camera. */
 | "insufficient-features"
/** What was to be seen has left the picture. */
 | "out-of-view"
/** Lost; an answer of the relocalizer is waited for. */
 | "relocalizing"
/** The last answer is far from the tracked position; the next one has to confirm it. */
 | "jump"
/** No answer for a while: the position may have drifted. */
 | "unconfirmed"
/** The camera gives the same picture again and again. */
 | "frozen"
/** The time of the frame is not after that of the one before. */
 | "clock"
/** The size of the picture has changed. */
 | "resized";
/** Why a frame could not be tracked. */
export type TrackLoss = "no-reference" | "no-frame" | "resized" | "out-of-view" | "few-found" | "disagreement";
/** What an answer since the frame before has changed. */
export interface Correction {
    /** How far the picture of the world moves for it, root mean square in pixels of the frame. */
    distancePx: number;
    /** Whether it is made at once, in place of fading in. */
    isJump: boolean;
}
interface TrackedCommon {
    /** Number of the frame, counted from 0. */
    index: number;
    timestampMs: number;
    state: FollowState;
    /** Present when the state is `limited`. */
    limited?: FollowLimit;
    correction?: Correction;
}
/** A frame with a position. */
export interface TrackedFrame extends TrackedCommon {
    located: true;
    /** `localization` in the very frame that the relocalizer answered for, `tracking` in all others. */
    by: "localization" | "tracking";
    /** For display: corrections fade in. */
    placement: Placement;
    /** What is believed, without fading. */
    believed: Placement;
    /** 6x6 row-major: rotation (rad, camera axes) then translation (scene units); of `believed`. */
    covariance: Float64Array;
    /** Frames and milliseconds since the one that was localised last. */
    age: {
        frames: number;
        ms: number;
    };
    /** Looked for, found, agreeing. */
    points: [number, number, number];
    lines: [number, number, number];
    medianErrorPx: number;
}
/** A frame without one. */
export interface LostFrame extends TrackedCommon {
    located: false;
    /** Why the tracker found nothing; absent while there is nothing to track yet. */
    loss?: TrackLoss;
}
export type FollowerResult = TrackedFrame | LostFrame;
export interface FollowerOptions {
    /** Milliseconds over which a correction fades in; 150 by default. */
    blendMs?: number;
}
/** Pixels in memory, four bytes each. */
export interface RgbaFrame {
    data: Uint8Array | Uint8ClampedArray;
    width: number;
    height: number;
}
/** What became of an answer: followed, waiting for the next one to confirm it, or why it is of no use. */
export type AnswerUse = "followed" | "unconfirmed" | TrackLoss;
/** Turn of the camera since the frame before, row by row (camera now from camera before, OpenCV axes). */
export type Turn = readonly number[] | Float64Array;
/**
 * Follows one camera. Hand in every frame with `track`, and for some of them what `locate` found, however late, with
 * `localized`. `follow` does both for a playing video.
 */
export declare class Follower {
    #private;
    private constructor();
    /** Makes one on this thread. The engine is compiled once for a page and its workers' scripts alike. */
    static create(options?: FollowerOptions & Pick<CreateOptions, "wasm" | "fetch" | "signal">): Promise<Follower>;
    /** Takes the next frame. A frame that cannot be tracked is a result, not an error. */
    track(frame: RgbaFrame, timestampMs: number, turned?: Turn): FollowerResult;
    /** Keeps a frame's picture, because it goes to the relocalizer. False when it is gone already. */
    hold(index: number): boolean;
    /**
     * Takes what the relocalizer found in a frame; it needs `include: ["points", "lines"]`. `width` and `height` are those of the
     * tracked frame, when another size was located.
     */
    localized(index: number, result: LocateResult, width?: number, height?: number): AnswerUse;
    /** `cameraFromWorld` near that of the newest frame, for `prior` of `locate`. */
    prior(): Float64Array | undefined;
    /** Forgets where the camera was, as for another scene. */
    reset(): void;
    dispose(): void;
}
export {};

// ---- index.d.ts

/** landline: finds the camera of a picture in a taught place, on the device. */
export { Relocalizer, packagedExtractorUrl, type RelocalizerEvents, type StateEvent } from "./relocalizer.js";
export { packagedWasmUrl } from "./builds.js";
export { LandlineError, type LandlineErrorCode } from "./errors.js";
export { camera, cameras, intrinsicsFromTrack, type Camera, type CameraDevice, type CameraOptions, type Facing } from "./camera.js";
export { follow, type FollowedAnswer, type FollowedFrame, type FollowEvents, type FollowOptions, type FollowResult, type Following, type Locator } from "./follow.js";
export { Follower, type AnswerUse, type Correction, type FollowLimit, type FollowState, type FollowerOptions, type FollowerResult, type LostFrame, type RgbaFrame, type TrackLoss, type TrackedFrame, type Turn } from "./follower.js";
export { motionSensors, type MotionSensors } from "./sensors.js";
export { drawInView, fromView, intrinsicsInView, project, projectionMatrix, toView, viewMap, type Fit, type View, type ViewMap } from "./view.js";
export { checkSupport } from "./support.js";
export { clearCache, isCached } from "./assets.js";
export { invertRigid, placementFrom } from "./placement.js";
export { focalLength35mm, focalPxFrom35mm } from "./exif.js";
export type * from "./types.js";

// ---- mapper/index.d.ts

/** landline/mapper: makes a scene of a film, on the device. */
export { Mapper, packagedMapperWasmUrl } from "./mapper.js";
export { readPoses } from "./poses.js";
export type * from "./types.js";

// ---- mapper/mapper.d.ts

import type { MemoryUse } from "../protocol.js";
import type { FrameSource } from "../types.js";
import type { BuildOptions, Coverage, FrameOptions, FrameVerdict, MapperEvents, MapperOptions, MapResult, WriteOptions } from "./types.js";
/** Where the mapping engine lies in this package. */
export declare function packagedMapperWasmUrl(): URL;
/**
 * Makes a scene of a film, on the device.
 *
 * Frames go in one by one; what helps is kept as features, pictures are not. Raises `verdict` for every frame and `coverage`
 * for every one that was kept.
 */
export declare class Mapper extends EventTarget {
    #private;
    private constructor();
    /** Loads the mapping engine and the extractor, side by side, and makes them ready. */
    static create(options?: MapperOptions): Promise<Mapper>;
    /** Frames that were kept. */
    get keyframes(): number;
    get coverage(): Coverage;
    /** Looks at a frame, and keeps what it shows if it helps; a map that was made before is out of date then. Frames are answered in the order of the calls; while a map is made they are refused. */
    addFrame(source: FrameSource, options?: FrameOptions): Promise<FrameVerdict>;
    /** Makes a scene of the keyframes. They stay, so that after an error or a cancel more can be filmed. */
    build(options?: BuildOptions): Promise<MapResult>;
    /** Writes the scene of the map that `build` made once more: with its lengths in metres, upright, or under another name. */
    write(options?: WriteOptions): Promise<MapResult>;
    /** Features and tracks of the map that `build` made, as the label file that `landline train` takes. Some hundred kilobytes a picture. */
    labels(): Promise<Uint8Array>;
    /** Forgets the film. */
    clear(): Promise<void>;
    /** Calls a listener with what an event tells; the answer takes it away again. */
    on<K extends keyof MapperEvents>(type: K, listener: (detail: MapperEvents[K]["detail"]) => void): () => void;
    /** Bytes that the engine holds. */
    memory(): Promise<MemoryUse>;
    /** Ends the worker and frees everything. Calls under way reject with `disposed`. Calling it twice is fine. */
    dispose(): Promise<void>;
    [Symbol.asyncDispose](): Promise<void>;
}

// ---- mapper/poses.d.ts

import type { KnownPoses, PoseFile, ReadPosesOptions } from "./types.js";
/**
 * Poses of pictures out of files that data sets come with: a COLMAP model (`images.txt` or `.bin`, with its cameras), a
 * matrix `NAME.pose.txt` beside each picture, or a list of poses. Pictures are given by their paths; what is no text and no model
 * is passed over, and a damaged file gives no pose and a note that names the place.
 *
 * Rejects as `Mapper.create` does where the engine cannot be loaded.
 */
export declare function readPoses(pictures: readonly string[], files: readonly PoseFile[], options?: ReadPosesOptions): Promise<KnownPoses>;

// ---- mapper/types.d.ts

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
    integrity?: {
        extractor?: string;
    };
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
"move-sideways"
/** Frames are blurred, or share too little with each other. */
 | "slower"
/** It is dark. */
 | "more-light"
/** There is enough for a map. */
 | "enough";
/** Why a frame was not kept. */
export type NotKeptReason = "too-similar" | "too-dark" | "blurred" | "too-few-features" | "size-changed" | "full";
/** What became of a frame. `keyframes` is how many there are now. */
export type FrameVerdict = {
    kept: true;
    keyframe: number;
    keyframes: number;
    advice?: Advice;
    reason?: undefined;
} | {
    kept: false;
    reason: NotKeptReason;
    keyframes: number;
    advice?: Advice;
};
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
    from: {
        keyframe: number;
        x: number;
        y: number;
    };
    to: {
        keyframe: number;
        x: number;
        y: number;
    };
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
    cloud: {
        points: Float32Array;
        lines: Float32Array;
    };
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

// ---- mapper/worker.d.ts

export {};

// ---- place/index.d.ts

/** landline/place: one place of many rooms from static files, on the device. */
export { Place, type PlaceEvents } from "./place.js";
export type * from "./types.js";

// ---- place/place.d.ts

import { LandlineError } from "../errors.js";
import { Follower, type FollowerOptions } from "../follower.js";
import type { Backend, Build, FrameSource, LiveOptions } from "../types.js";
import type { PlaceLocateOptions, PlaceManifest, PlaceMemory, PlaceOptions, PlaceResult, PlaceRoom } from "./types.js";
/** What listeners get. */
export interface PlaceEvents {
    /** The camera has come into another room; before the `result` that says so. */
    room: CustomEvent<{
        room: PlaceRoom;
        result: PlaceResult;
    }>;
    /** Every frame. */
    result: CustomEvent<PlaceResult>;
    /** A room whose scene could not be loaded or used. The others go on. */
    refused: CustomEvent<{
        room: PlaceRoom;
        error: LandlineError;
    }>;
}
/**
 * Finds the camera in a place of many rooms. Scenes are loaded as they are needed, checked against the manifest, and kept.
 *
 * Raises `room` when the camera has come into another room, `result` for every frame, and `refused` for a room whose scene
 * could not be had.
 */
export declare class Place extends EventTarget {
    #private;
    readonly manifest: PlaceManifest;
    /** The build of the engine. */
    readonly build: Build;
    /** Why this one. */
    readonly buildReason: string;
    readonly backend: Backend;
    /** Why not something faster. */
    readonly backendReason = "places run on the CPU";
    private constructor();
    /** Loads the engine, the extractor, the manifest and its index, and no scene yet. */
    static create(options: PlaceOptions): Promise<Place>;
    /** The room that the camera was in last. */
    get room(): PlaceRoom | undefined;
    /** True while no frame is under way: the moment to hand in the newest one. */
    get idle(): boolean;
    /**
     * Finds the camera of one frame, in whatever room; scenes that are needed for that are loaded first. Frames are answered in
     * the order of the calls; an aborted one rejects at once.
     */
    locate(source: FrameSource, options?: PlaceLocateOptions): Promise<PlaceResult>;
    /** Loads a room's scene before it is needed, by its id; false when it cannot be had, which `refused` tells. */
    load(room: string): Promise<boolean>;
    /** Follows one camera on the caller's thread, with the engine that was loaded already; `follow` asks for it. */
    follower(options?: FollowerOptions): Promise<Follower>;
    /** Changes options; those left out stay. */
    setOptions(options: LiveOptions): Promise<void>;
    /** Takes over the focal length that an earlier session learned of a camera, as `Relocalizer.recallCamera` does. */
    recallCamera(camera: string, focalPerWidth: number): Promise<void>;
    /** Calls a listener with what an event tells; the answer takes it away again. */
    on<K extends keyof PlaceEvents>(type: K, listener: (detail: PlaceEvents[K]["detail"]) => void): () => void;
    /** Forgets which room the camera is in: the next frame is located from nothing. Scenes at hand stay. */
    reset(): Promise<void>;
    /** Bytes that the engine holds, and how many of them are scenes. */
    memory(): Promise<PlaceMemory>;
    /** Ends the worker and frees everything. Frames under way reject with `disposed`. Calling it twice is fine. */
    dispose(): Promise<void>;
    [Symbol.asyncDispose](): Promise<void>;
}

// ---- place/types.d.ts

/** What pages see of places of many rooms. */
import type { CreateOptions, LiveOptions, LocateOptions, LocateResult, Placement } from "../types.js";
/** A file of a place, and what it has to be. */
export interface PlaceFile {
    /** Relative to the manifest, or absolute. */
    url: string;
    bytes: number;
    /** Of its bytes, in lower-case hexadecimal. */
    sha256: string;
}
/** A room as `NAME.place.json` has it. */
export interface PlaceRoom {
    id: string;
    /** What people call it. */
    name?: string;
    scene: PlaceFile;
    /** From the room to the place: unit quaternion w, x, y, z, shift and scale. */
    place_from_room?: {
        qwxyz: readonly number[];
        t: readonly number[];
        scale?: number;
    };
    floor?: number;
    /** Rooms that one can walk to. */
    neighbours?: readonly string[];
    /** Corners of its floor plan in the room's world, counter-clockwise seen from above. */
    outline?: readonly (readonly number[])[];
}
/** `NAME.place.json`, as `landline place` writes it. */
export interface PlaceManifest {
    landline: "place";
    format: number;
    name?: string;
    extractor: string;
    extractor_sha256: string;
    working_max_side: number;
    index: PlaceFile;
    rooms: readonly PlaceRoom[];
}
/** What every answer of a place has besides. */
export interface InPlace {
    /** The room that the camera is in; absent where that is not known. */
    room?: PlaceRoom;
    /** Ids of two rooms that look alike from there: which of them it is stays open, and the frame is not located. */
    rivals?: readonly [string, string];
    /** Ids of rooms that it may be, but whose scenes could not be had; `refused` told why. */
    missing?: readonly string[];
    /** Where the camera is in the place; present where the room's transform is known. */
    placementInPlace?: Placement;
}
/** What `Place.locate` answers: `placement` is in the room. */
export type PlaceResult = LocateResult & InPlace;
/** Options of `Place.create`. Places run on the CPU. */
export interface PlaceOptions extends LiveOptions, Pick<CreateOptions, "extractor" | "build" | "onProgress" | "signal" | "wasm" | "worker" | "workerUrl" | "cache" | "stallTimeoutMs" | "fetch"> {
    /** A `.place.json` file. */
    place: string | URL;
    /** Bytes that the engine may hold of scenes; 128 MiB by default. The rooms that were not needed for longest go. */
    maxBytes?: number;
    /** Load the rooms beside one that is entered; yes by default. */
    prefetch?: boolean;
}
/** Options of one `locate` call. */
export type PlaceLocateOptions = Omit<LocateOptions, "prior" | "explain">;
/** What the engine of a place holds, in bytes. */
export interface PlaceMemory {
    wasmBytes: number;
    /** Of these, scenes. */
    sceneBytes: number;
}

// ---- place/worker.d.ts

export {};

// ---- placement.d.ts

import type { Placement } from "./types.js";
/**
 * Inverse of a rigid transform, a row-major 4x4 matrix: of `cameraFromWorld` the `worldFromCamera`, and the other way round.
 * @throws LandlineError `bad-input` for what is no 16 finite numbers.
 */
export declare function invertRigid(m: ArrayLike<number>): Float64Array;
/** All forms of a placement from its row-major `cameraFromWorld`; throws as `invertRigid`. */
export declare function placementFrom(cameraFromWorld: Float64Array): Placement;

// ---- protocol.d.ts

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
    create: {
        request: CreateRequest;
        reply: Created;
    };
    locate: {
        request: LocateRequest;
        reply: LocateResult;
    };
    setOptions: {
        request: LiveOptions;
        reply: null;
    };
    recallCamera: {
        request: {
            camera: string;
            focalPerWidth: number;
        };
        reply: null;
    };
    reset: {
        request: null;
        reply: null;
    };
    memory: {
        request: null;
        reply: MemoryUse;
    };
    dispose: {
        request: null;
        reply: null;
    };
}
export type CallName = keyof Calls;
export type Request<N extends CallName = CallName> = CallRequest<Calls, N>;
export type Reply = CallReply;

// ---- relocalizer.d.ts

import { Follower, type FollowerOptions } from "./follower.js";
import type { MemoryUse } from "./protocol.js";
import type { Backend, Build, CreateOptions, FrameSource, LiveOptions, LocateOptions, LocateResult, SceneInfo } from "./types.js";
/** Where the extractor's weights lie in this package. */
export declare function packagedExtractorUrl(): URL;
/** What `searching`, `tracking` and `limited` listeners get; `detail` is the result that led there. */
export type StateEvent = CustomEvent<LocateResult>;
/** Events of a relocalizer: every result, and the changes of the state over several frames. */
export interface RelocalizerEvents {
    result: StateEvent;
    searching: StateEvent;
    tracking: StateEvent;
    limited: StateEvent;
}
/** Types of the events; the methods are those of `EventTarget`. */
export interface Relocalizer {
    addEventListener<K extends keyof RelocalizerEvents>(type: K, listener: (event: RelocalizerEvents[K]) => void, options?: boolean | AddEventListenerOptions): void;
    addEventListener(type: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | AddEventListenerOptions): void;
    removeEventListener<K extends keyof RelocalizerEvents>(type: K, listener: (event: RelocalizerEvents[K]) => void, options?: boolean | EventListenerOptions): void;
    removeEventListener(type: string, listener: EventListenerOrEventListenerObject | null, options?: boolean | EventListenerOptions): void;
}
/**
 * Finds the camera in one taught place.
 *
 * Raises the events `searching`, `tracking` and `limited` (`CustomEvent` with the result as `detail`) whenever the
 * state over several frames changes, and `result` for every frame.
 */
export declare class Relocalizer extends EventTarget {
    #private;
    /** What the scene file says about itself. */
    readonly scene: SceneInfo;
    /** The build of the engine. */
    readonly build: Build;
    /** Why this one. */
    readonly buildReason: string;
    private constructor();
    /** Loads the engine, the extractor and the scene, side by side, and makes them ready. */
    static create(options: CreateOptions): Promise<Relocalizer>;
    /** What executes the networks. */
    get backend(): Backend;
    /** Why not something faster. */
    get backendReason(): string;
    get state(): LocateResult["state"];
    /** True while no frame is under way: the moment to hand in the newest one. */
    get idle(): boolean;
    /** Finds the camera of one frame. Frames are answered in the order of the calls; an aborted one rejects at once. */
    locate(source: FrameSource, options?: LocateOptions): Promise<LocateResult>;
    /** Follows one camera on the caller's thread, with the engine that was loaded already. */
    follower(options?: FollowerOptions): Promise<Follower>;
    /** Changes options; those left out stay. */
    setOptions(options: LiveOptions): Promise<void>;
    /**
     * Takes over the focal length that an earlier session learned of a camera, as a start that frames of this session
     * correct. What a session has learned stands in results whose `intrinsics.source` is `remembered`: `fx / width`.
     */
    recallCamera(camera: string, focalPerWidth: number): Promise<void>;
    /** Forgets where the camera was: the next frame is located from nothing. */
    reset(): Promise<void>;
    /** Bytes that the engine holds. */
    memory(): Promise<MemoryUse>;
    /** Ends the worker and frees everything. Frames under way reject with `disposed`. Calling it twice is fine. */
    dispose(): Promise<void>;
    [Symbol.asyncDispose](): Promise<void>;
}

// ---- rpc.d.ts

/** Calls to another thread, or to this one in the same manner. What the calls are is the caller's. */
import { LandlineError, type PlainError } from "./errors.js";
/** Name of a call → what goes there and what comes back. */
export type CallTable<C> = {
    [N in keyof C]: {
        request: unknown;
        reply: unknown;
    };
};
export interface CallRequest<C extends CallTable<C>, N extends keyof C = keyof C> {
    id: number;
    call: N;
    request: C[N]["request"];
}
export type CallReply = {
    id: number;
    ok: true;
    reply: unknown;
} | {
    id: number;
    ok: false;
    error: PlainError;
};
export interface Channel<C extends CallTable<C>> {
    call<N extends keyof C & string>(name: N, request: C[N]["request"], transfer?: Transferable[]): Promise<C[N]["reply"]>;
    /** Rejects everything that is under way, and ends the worker. */
    close(): void;
}
export declare class WorkerChannel<C extends CallTable<C>> implements Channel<C> {
    #private;
    /** `onEvent` gets what the worker tells without being asked. */
    constructor(start: () => Worker, disposed: () => LandlineError, onEvent?: (event: unknown) => void);
    call<N extends keyof C & string>(name: N, request: C[N]["request"], transfer?: Transferable[]): Promise<C[N]["reply"]>;
    close(): void;
}
/** Answers one call. */
type Perform<C extends CallTable<C>> = <N extends keyof C & string>(name: N, request: C[N]["request"]) => Promise<C[N]["reply"]>;
/** Calls are performed one after another, but for the `urgent` ones, which do not wait. */
export declare class DirectChannel<C extends CallTable<C>> implements Channel<C> {
    #private;
    constructor(perform: Perform<C>, dispose: () => unknown, disposed: () => LandlineError, urgent?: readonly string[]);
    call<N extends keyof C & string>(name: N, request: C[N]["request"]): Promise<C[N]["reply"]>;
    close(): void;
}
/** An answer, until the signal says that nobody wants it. */
export declare function unless<T>(signal: AbortSignal | undefined, answer: Promise<T>): Promise<T>;
/** Keeps the order of calls whose preparation takes more or less time, as decoding does. */
export declare class InOrder {
    #private;
    /** Calls `hand` when `ready` is, and all from before are handed over. */
    next<R, A>(ready: Promise<R>, hand: (ready: R) => Promise<A>): Promise<A>;
}
export {};

// ---- sample.d.ts

/**
 * A room to try the package with: optional entry `landline/sample`. Its files lie in the package and are loaded where they are
 * asked for; a page that does not import this entry never loads them.
 *
 * The room is a rendered one, and its lengths are metres.
 */
import type { Intrinsics } from "./types.js";
/** The scene file. */
export declare const scene: URL;
/** A picture of the room that was not among those that taught the scene. */
export declare const picture: URL;
/** The picture's camera. */
export declare const intrinsics: Intrinsics;
/** Where the picture was taken, in the scene's coordinates. */
export declare const position: {
    x: number;
    y: number;
    z: number;
};

// ---- sensors.d.ts

/** Gravity as `locate` takes it. */
export interface CameraGravity {
    /** Unit vector downwards in camera axes: x right, y down, z forward. */
    x: number;
    y: number;
    z: number;
    /** Standard deviation in radians. */
    sigmaRad: number;
}
export interface MotionSensors {
    /** Turn since the last call, row by row (camera now from camera before); `undefined` while no sensor speaks. */
    turnSinceLastFrame(now: number): Float64Array | undefined;
    /** `undefined` while no sensor speaks. */
    gravity(): CameraGravity | undefined;
    stop(): void;
}
/**
 * Listens to the motion sensors. Call it from a tap: iOS asks the user then, and only then. Without sensors nothing is wrong: all
 * readings are `undefined`, and tracking goes by the picture alone.
 */
export declare function motionSensors(): Promise<MotionSensors>;
/** A vector of the device (x right, y up, z out of the screen, held naturally) in the axes of the rear camera. */
export declare function cameraFromDevice([x, y, z]: readonly [number, number, number], angleDeg: number): [number, number, number];
/** Downwards in device axes, from the angles of a DeviceOrientationEvent in degrees. */
export declare function gravityFromAngles(beta: number, gamma: number): [number, number, number];
/** Rotation matrix of a rotation vector, row by row (Rodrigues). */
export declare function rotationFromVector([x, y, z]: readonly [number, number, number]): Float64Array;

// ---- support.d.ts

/** What this browser offers. */
import type { Support } from "./types.js";
export declare function hasSimd(): boolean;
export declare function hasRelaxedSimd(): boolean;
/** True where the code runs under Node rather than in a browser or a worker of one. */
export declare function isNode(): boolean;
/** Tells whether the engine can run here, and what it could use. Loads nothing. */
export declare function checkSupport(): Promise<Support>;

// ---- types.d.ts

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
export type FrameSource = RawFrame | ImageData | ImageBitmap | VideoFrame | Blob | HTMLCanvasElement | OffscreenCanvas | HTMLVideoElement | HTMLImageElement;
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
"given"
/** The camera track's settings. */
 | "track"
/** The picture's EXIF data. */
 | "exif";
/** How the intrinsics of a result came to be known. */
export type IntrinsicsSource = KnownIntrinsicsSource
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
"few-features"
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
    position: {
        x: number;
        y: number;
        z: number;
    };
    /** Rotation part of `worldFromCamera` as a unit quaternion. */
    rotation: {
        w: number;
        x: number;
        y: number;
        z: number;
    };
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
    frame: {
        width: number;
        height: number;
    };
    /** The frame's time as passed in, else the time of the call. */
    timestampMs: number;
    intrinsics: Intrinsics & {
        source: IntrinsicsSource; /** Standard deviation of the focal length / focal length. */
        relativeSigma?: number;
    };
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
    gravity?: {
        x: number;
        y: number;
        z: number; /** Standard deviation in radians; two degrees by default. */
        sigmaRad?: number;
    };
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
    integrity?: {
        scene?: string;
        extractor?: string;
    };
    /** Used for every download. */
    fetch?: typeof fetch;
}
/** Files that are loaded. */
export type LoadedFile = "engine" | "extractor" | "scene" | "place" | "index";
export type ProgressEvent = {
    status: "download";
    file: LoadedFile;
    url: string;
    loaded: number; /** 0 when unknown. */
    total: number;
    fromCache: boolean;
} | {
    status: "done";
    file: LoadedFile;
    bytes: number;
    fromCache: boolean; /** Kept from an earlier visit, and the server could not be asked whether it is still right. */
    unchecked?: true;
} | {
    status: "prepare";
} | {
    status: "ready";
    backend: Backend;
    backendReason: string;
    build: Build;
    buildReason: string;
};
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
    up?: {
        x: number;
        y: number;
        z: number;
    };
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

// ---- view.d.ts

import type { Intrinsics, Placement } from "./types.js";
/** How a frame fills its place; as CSS `object-fit`, centred. */
export type Fit = "cover" | "contain" | "fill";
/** Where a frame is shown. Sizes are in whatever unit positions are wanted in: CSS pixels, or those of the canvas. */
export interface View {
    width: number;
    height: number;
    /** `cover` by default. */
    fit?: Fit;
    /** Left and right change places, as for a camera that faces the user. */
    mirrored?: boolean;
}
/** `x * scaleX + offsetX`, likewise y. */
export interface ViewMap {
    scaleX: number;
    scaleY: number;
    offsetX: number;
    offsetY: number;
}
interface Size {
    width: number;
    height: number;
}
/** The map from pixels of a frame to positions in a view. */
export declare function viewMap(frame: Size, view: View): ViewMap;
/** Where a pixel of the frame stands in the view. */
export declare function toView(map: ViewMap, [x, y]: readonly [number, number]): [number, number];
/** Which pixel of the frame stands at a position of the view: for taps. */
export declare function fromView(map: ViewMap, [x, y]: readonly [number, number]): [number, number];
/** The pixel of the frame at which a world point is seen; `undefined` behind the camera. */
export declare function project(placement: Placement, intrinsics: Intrinsics, world: ArrayLike<number>): [number, number] | undefined;
/** Draws a frame into a view; what a canvas shows then is the picture that the positions belong to. */
export declare function drawInView(context: CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D, frame: Size & {
    source: CanvasImageSource;
}, view: View): ViewMap;
/** Intrinsics of the view as a picture of its own; for one that is not mirrored. */
export declare function intrinsicsInView(intrinsics: Intrinsics, view: View): Intrinsics;
/** Column-major projection for WebGL whose picture covers exactly the frame, off-centre principal point included. */
export declare function projectionMatrix(intrinsics: Intrinsics, near: number, far: number): Float64Array;
export {};

// ---- worker.d.ts

export {};
