/** The device's camera. */
import { checkOptions, kind, number, object, oneOf, type Check } from "./arguments.js";
import { LandlineError } from "./errors.js";
import { unless } from "./rpc.js";
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

const problems: Record<string, { code: "camera-denied" | "camera-unavailable" | "camera-busy"; message: string; hint: string }> = {
  NotAllowedError: { code: "camera-denied", message: "the camera is not allowed on this page", hint: "Allow it in the browser's address bar (the camera or settings symbol), then try again." },
  SecurityError: { code: "camera-denied", message: "the camera is blocked for this page", hint: "If the page is embedded, its frame needs allow=\"camera\"." },
  NotFoundError: { code: "camera-unavailable", message: "no camera was found", hint: "Connect a camera, or use a picture or a video." },
  OverconstrainedError: { code: "camera-unavailable", message: "no camera fits what was asked for", hint: "Choose another camera." },
  NotReadableError: { code: "camera-busy", message: "the camera is in use", hint: "Close the other program or tab that uses it, then try again." },
  AbortError: { code: "camera-busy", message: "the camera stopped while starting", hint: "Try again." },
};

const pixels = number(1, 1e6, "pixels, at least 1");
const options: Record<keyof CameraOptions, Check> = {
  deviceId: kind("string"),
  facing: oneOf("environment", "user"),
  width: pixels,
  height: pixels,
  signal: object,
};

function devices(): MediaDevices {
  const media: Partial<MediaDevices> | undefined = globalThis.navigator?.mediaDevices;
  if (media?.getUserMedia) return media as MediaDevices;
  if (globalThis.isSecureContext === false) {
    throw new LandlineError("camera-insecure", "browsers give the camera only to pages loaded over HTTPS or from this computer", "Open the page with https://, or use a picture or a video.");
  }
  throw new LandlineError("camera-unavailable", "this browser offers no camera", "Open the page in a browser rather than inside another app, or use a picture or a video.");
}

/** The cameras of this device. */
export async function cameras(): Promise<CameraDevice[]> {
  const found = (await devices().enumerateDevices()).filter((device) => device.kind === "videoinput");
  return found.map(({ deviceId, label }, i) => ({ deviceId, label: label || `Camera ${i + 1}` }));
}

const close = (stream: MediaStream): void => stream.getTracks().forEach((track) => track.stop());

async function streamOf(size: MediaTrackConstraints, which: MediaTrackConstraints): Promise<MediaStream> {
  try {
    return await devices().getUserMedia({ audio: false, video: { ...size, ...which } });
  } catch (error) {
    if (error instanceof LandlineError) throw error;
    const known = problems[(error as Error).name];
    if (known) throw new LandlineError(known.code, known.message, known.hint, error);
    throw new LandlineError("camera-unavailable", `the camera cannot be opened: ${String((error as Error).message ?? error)}`, "Try again, or use a picture or a video.", error);
  }
}

async function play(video: HTMLVideoElement, stream: MediaStream): Promise<void> {
  video.srcObject = stream;
  try {
    await video.play();
  } catch (error) {
    close(stream);
    throw new LandlineError("camera-unavailable", `the camera's picture cannot be shown: ${String((error as Error).message ?? error)}`, "Try again.", error);
  }
}

/** Opens a camera. Call it from a click or a tap: browsers ask the user. */
export async function camera(given: CameraOptions = {}): Promise<Camera> {
  checkOptions("camera", given, options);
  const { deviceId, facing = "environment", width = 1280, height = 720, signal } = given;
  signal?.throwIfAborted();
  const size: MediaTrackConstraints = { width: { ideal: width }, height: { ideal: height } };
  const asked = streamOf(size, deviceId === undefined ? { facingMode: { ideal: facing } } : { deviceId: { exact: deviceId } });
  // The browser's question cannot be taken back: what it opens too late is closed.
  asked.then((late) => signal?.aborted && close(late)).catch(() => undefined);
  let stream = await unless(signal, asked);
  const video = document.createElement("video");
  video.muted = true;
  video.playsInline = true;
  await play(video, stream);
  let stopped = false;
  const track = (): MediaStreamTrack | undefined => stream.getVideoTracks()[0];
  return {
    get stream(): MediaStream {
      return stream;
    },
    video,
    key(): string {
      const settings = track()?.getSettings() as (MediaTrackSettings & { zoom?: number }) | undefined;
      return [settings?.deviceId ?? "", track()?.label ?? "", `${video.videoWidth}x${video.videoHeight}`, settings?.zoom ?? 1].join("|");
    },
    async flip(): Promise<void> {
      const { deviceId: now, facingMode } = track()?.getSettings() ?? {};
      const ids = (await cameras()).map((device) => device.deviceId);
      if (ids.length < 2) throw new LandlineError("camera-unavailable", "there is no other camera");
      const next = ids[(ids.indexOf(now ?? "") + 1) % ids.length] ?? "";
      // Phones open one camera at a time.
      close(stream);
      let failed: unknown;
      try {
        stream = await streamOf(size, facingMode ? { facingMode: { exact: facingMode === "user" ? "environment" : "user" } } : { deviceId: { exact: next } });
      } catch (error) {
        failed = error;
        stream = await streamOf(size, now ? { deviceId: { exact: now } } : {});
      }
      if (stopped) return close(stream);
      await play(video, stream);
      if (failed) throw failed;
    },
    async torch(on: boolean): Promise<boolean> {
      const has = track()?.getCapabilities?.() as (MediaTrackCapabilities & { torch?: boolean }) | undefined;
      if (!has?.torch) return false;
      await track()?.applyConstraints({ advanced: [{ torch: on } as MediaTrackConstraintSet] });
      return true;
    },
    stop(): void {
      stopped = true;
      close(stream);
      video.srcObject = null;
    },
  };
}

/** Intrinsics from the track's settings, in the form of the W3C proposal; no browser fills them in yet. */
export function intrinsicsFromTrack(track: MediaStreamTrack | undefined): Intrinsics | undefined {
  const settings = track?.getSettings() as (MediaTrackSettings & { focalLengthX?: number; focalLengthY?: number; principalPointX?: number; principalPointY?: number }) | undefined;
  if (!settings?.width || !settings.height || !(Number(settings.focalLengthX) > 1)) return undefined;
  const fx = Number(settings.focalLengthX);
  return {
    fx,
    fy: Number(settings.focalLengthY ?? fx),
    cx: Number(settings.principalPointX ?? settings.width / 2),
    cy: Number(settings.principalPointY ?? settings.height / 2),
    width: settings.width,
    height: settings.height,
  };
}
