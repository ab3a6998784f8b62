/** Follows a playing video: a result for every frame, with its picture. */
import { anything, checkArgument, checkOptions, included, intrinsics, kind, number, object, type Check } from "./arguments.js";
import { intrinsicsFromTrack } from "./camera.js";
import { LandlineError } from "./errors.js";
import { Follower, type AnswerUse, type FollowerResult, type LostFrame, type TrackedFrame } from "./follower.js";
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
export type FollowResult = (TrackedFrame & Pictured & { intrinsics: Intrinsics }) | (LostFrame & Pictured);

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
  locate(...call: Parameters<Relocalizer["locate"]>): Promise<LocateResult & { /** The world that the positions are in, where there are several. */ room?: { id: string } }>;
}

/** Longest side of the picture that is tracked. */
const trackedSide = 640;

const positive = number(Number.MIN_VALUE, Infinity, "a number above 0");
const known: Record<keyof FollowOptions, Check> = {
  intrinsics,
  include: included,
  camera: anything, // locate() checks it
  maxFps: positive,
  maxLocalizationsPerSecond: positive,
  blendMs: number(0, Infinity, "a number of 0 or more"),
  sensors: object,
  onResult: kind("function"),
  onAnswer: kind("function"),
  onError: kind("function"),
};

const locator: Check = (value) => (typeof (value as Locator | undefined)?.follower === "function" ? undefined : "a Relocalizer or a Place");
const videoElement: Check = (value) => (value instanceof HTMLVideoElement ? undefined : "a video element");

/** Picture of the video now: without a copy where the browser can hold it, else what was drawn for the tracker. */
class Held implements FollowedFrame {
  readonly width: number;
  readonly height: number;
  readonly source: CanvasImageSource;

  constructor(video: HTMLVideoElement, fallback: () => CanvasImageSource) {
    this.width = video.videoWidth;
    this.height = video.videoHeight;
    let source: CanvasImageSource | undefined;
    if (typeof VideoFrame === "function") {
      try {
        source = new VideoFrame(video);
      } catch {
        source = undefined; // a video without a current frame, or of another origin
      }
    }
    this.source = source ?? fallback();
  }

  draw(context: CanvasRenderingContext2D | OffscreenCanvasRenderingContext2D, x = 0, y = 0, width = context.canvas.width, height = context.canvas.height): void {
    context.drawImage(this.source, x, y, width, height);
  }

  bitmap(): Promise<ImageBitmap> {
    return createImageBitmap(this.source as ImageBitmapSource);
  }

  /** For the relocalizer, which closes what it gets. */
  copy(): VideoFrame | Promise<ImageBitmap> {
    return typeof VideoFrame === "function" && this.source instanceof VideoFrame ? this.source.clone() : this.bitmap();
  }

  close(): void {
    if (typeof VideoFrame === "function" && this.source instanceof VideoFrame) this.source.close();
  }
}

class Loop extends EventTarget {
  readonly #relocalizer: Locator;
  readonly #video: HTMLVideoElement;
  readonly #options: FollowOptions;
  readonly #context: CanvasRenderingContext2D;
  #follower: Follower | undefined;
  #running = true;
  #request = 0;
  #inFlight = 0;
  #lastFrame = -Infinity;
  #lastAsked = -Infinity;
  #last: FollowResult | undefined;
  #held: Held | undefined;
  #intrinsics: Intrinsics | undefined;
  #told = "";
  #isHeard = false;
  #world: string | undefined;
  dropped = 0;
  processed = 0;
  answered = 0;

  constructor(relocalizer: Locator, video: HTMLVideoElement, options: FollowOptions) {
    super();
    this.#relocalizer = relocalizer;
    this.#video = video;
    this.#options = options;
    const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true, alpha: false });
    if (!context) throw new LandlineError("unsupported", "this browser gives no 2D canvas to read pixels with");
    this.#context = context;
    const { blendMs } = options;
    relocalizer
      .follower(blendMs === undefined ? {} : { blendMs })
      .then((follower) => {
        if (this.#running) this.#follower = follower;
        else follower.dispose();
      })
      .catch((error: unknown) => this.#fail(error));
    video.addEventListener("error", this.#broken);
    // Once those who made this loop listen to it.
    if (video.error) queueMicrotask(this.#broken);
    this.#schedule();
  }

  readonly #broken = (): void => {
    const why = this.#video.error?.message;
    if (this.#running) this.#fail(new LandlineError("asset-fetch", `the video does not play${why ? `: ${why}` : ""}`, "Check its address and its format."));
  };

  override addEventListener(...listening: Parameters<EventTarget["addEventListener"]>): void {
    this.#isHeard ||= listening[0] === "error";
    super.addEventListener(...listening);
  }

  stop(): void {
    if (!this.#running) return;
    this.#running = false;
    this.#video.removeEventListener("error", this.#broken);
    if ("cancelVideoFrameCallback" in this.#video) this.#video.cancelVideoFrameCallback(this.#request);
    else cancelAnimationFrame(this.#request);
    this.#held?.close();
    this.#follower?.dispose();
    this.#follower = undefined;
  }

  #schedule(): void {
    const video = this.#video;
    this.#request = "requestVideoFrameCallback" in video
      ? video.requestVideoFrameCallback((now, { mediaTime }) => this.#step(now, 1000 * mediaTime))
      : requestAnimationFrame((now) => this.#step(now, now));
  }

  #step(now: number, mediaMs: number): void {
    if (!this.#running) return;
    this.#schedule();
    const { maxFps = Infinity } = this.#options;
    if (document.hidden || this.#video.videoWidth === 0 || !this.#follower) return;
    // A display of 60 Hz gives frames of a 30 Hz camera a little early or late.
    if (now - this.#lastFrame < 0.8 * (1000 / maxFps)) {
      this.dropped += 1;
      return;
    }
    this.#lastFrame = now;
    try {
      this.#track(this.#follower, now, mediaMs);
    } catch (error) {
      this.#fail(error);
    }
  }

  #track(follower: Follower, now: number, mediaMs: number): void {
    const started = performance.now();
    const { canvas } = this.#context;
    this.#held?.close();
    const held = new Held(this.#video, () => canvas);
    this.#held = held;
    const shrink = Math.min(1, trackedSide / Math.max(held.width, held.height));
    const [width, height] = [held.width, held.height].map((side) => Math.max(1, Math.round(shrink * side))) as [number, number];
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    this.#context.drawImage(held.source === canvas ? this.#video : held.source, 0, 0, width, height);
    const tracked = follower.track(this.#context.getImageData(0, 0, width, height), mediaMs, this.#options.sensors?.turnSinceLastFrame(now));
    const trackingMs = performance.now() - started;
    this.processed += 1;
    this.#publish(tracked, held, performance.timeOrigin + now, trackingMs);
    if (this.#running) this.#ask(follower, tracked.index, held, now, [width, height]);
  }

  /** Hands the frame to the relocalizer, when that is idle. */
  #ask(follower: Follower, index: number, held: Held, now: number, tracked: [number, number]): void {
    const { options, relocalizer } = { options: this.#options, relocalizer: this.#relocalizer };
    const interval = 1000 / (options.maxLocalizationsPerSecond ?? Infinity);
    // The GPU works on a frame while the pose of the one before is solved: two may be under way there.
    const room = relocalizer.backend === "webgpu" ? 2 : 1;
    if (this.#inFlight >= room || now - this.#lastAsked < interval) return;
    this.#lastAsked = now;
    this.#inFlight += 1;
    follower.hold(index);
    // The loop's own copy is closed with the next frame; listeners of the answer get this one.
    const shown = held.copy();
    const handed = held.copy();
    const answer = async (): Promise<void> => {
      const pictures = await Promise.all([shown, handed]);
      try {
        const name = typeof options.camera === "function" ? options.camera() : options.camera;
        const stream = this.#video.srcObject;
        const track = stream instanceof MediaStream ? stream.getVideoTracks()[0] : undefined;
        const own = this.#given(held);
        const given = own ?? fitting(intrinsicsFromTrack(track), held);
        const include: Include[] = [...new Set<Include>(["points", "lines", ...(options.include ?? [])])];
        const gravity = options.sensors?.gravity();
        const result = await relocalizer.locate(pictures[1], {
          tracking: true,
          transfer: true,
          timestamp: performance.timeOrigin + now,
          include,
          ...(given ? { intrinsics: given, intrinsicsSource: own ? "given" : "track" } : {}),
          ...(name === undefined ? {} : { camera: name }),
          ...(gravity ? { gravity } : {}),
        });
        if (!this.#running) return;
        this.answered += 1;
        // Positions of another room are in another world.
        const world = result.room?.id ?? this.#world;
        if (world !== this.#world && this.#world !== undefined) follower.reset();
        this.#world = world;
        const use = follower.localized(index, result, ...tracked);
        if (result.located) this.#intrinsics = result.intrinsics;
        const picture = pictures[0];
        const frame: FollowedFrame = {
          width: held.width,
          height: held.height,
          source: picture,
          draw: (context, x = 0, y = 0, w = context.canvas.width, h = context.canvas.height) => context.drawImage(picture, x, y, w, h),
          bitmap: () => createImageBitmap(picture),
        };
        const detail: FollowedAnswer = { result, frame, use };
        call(options.onAnswer, detail);
        this.dispatchEvent(new CustomEvent("answer", { detail }));
      } finally {
        pictures[0].close();
      }
    };
    answer()
      .catch((error: unknown) => this.#fail(error))
      .finally(() => (this.#inFlight -= 1));
  }

  /** The given intrinsics, where they are of this shape; else that is told. */
  #given(frame: { width: number; height: number }): Intrinsics | undefined {
    const { intrinsics } = this.#options;
    const fits = fitting(intrinsics, frame);
    if (intrinsics && !fits) {
      const { width, height } = intrinsics;
      this.#fail(new LandlineError("bad-input", `the intrinsics are for ${width} x ${height}, the video is ${frame.width} x ${frame.height}: the shapes differ, so they are left out`, "A turned phone swaps width and height."));
    }
    return fits;
  }

  #publish(tracked: FollowerResult, frame: FollowedFrame, timestampMs: number, trackingMs: number): void {
    const intrinsics = this.#intrinsics;
    const result = { ...tracked, timestampMs, frame, trackingMs, ...(intrinsics ? { intrinsics } : {}) } as FollowResult;
    const before = this.#last;
    this.#last = result;
    call(this.#options.onResult, result);
    const send = (type: keyof FollowEvents): void => void this.dispatchEvent(new CustomEvent(type, { detail: result }));
    send("result");
    if (result.located && !before?.located) send("found");
    if (!result.located && before?.located) send("lost");
    if (result.limited !== before?.limited) send("limited");
    if (result.correction) send("corrected");
  }

  /** The same fault with every frame is told once. */
  #fail(error: unknown): void {
    const code = error instanceof LandlineError ? error.code : "";
    if (code === "disposed" || code === "engine-defect") this.stop();
    const words = String((error as Error)?.message ?? error);
    if (words === this.#told) return;
    this.#told = words;
    // A page that leaves may dispose before it stops: whoever listens hears of it, the console does not.
    if (!this.#options.onError && !this.#isHeard && code !== "disposed") reportError(error);
    call(this.#options.onError, error);
    this.dispatchEvent(new CustomEvent("error", { detail: error }));
  }
}

/** What a page's own function throws goes to the console. */
function call<T>(listener: ((value: T) => void) | undefined, value: T): void {
  try {
    listener?.(value);
  } catch (error) {
    reportError(error);
  }
}

/** Intrinsics for a picture of this shape; those of a turned or cropped one are of no use. */
function fitting(intrinsics: Intrinsics | undefined, { width, height }: { width: number; height: number }): Intrinsics | undefined {
  if (!intrinsics) return undefined;
  const shape = (width * (intrinsics.height || height)) / (height * (intrinsics.width || width));
  return Math.abs(shape - 1) <= 0.005 ? intrinsics : undefined;
}

/**
 * Gives a position for every frame of a playing video, tracked between the answers of the relocalizer; pauses while the page is
 * hidden. Tracking runs on this thread, so that the result comes in the very callback in which the frame is shown.
 */
export function follow(relocalizer: Locator, video: HTMLVideoElement, options: FollowOptions = {}): Following {
  checkArgument("the relocalizer", relocalizer, locator);
  checkArgument("the video", video, videoElement);
  checkOptions("follow", options, known);
  return new Loop(relocalizer, video, options) as unknown as Following;
}
