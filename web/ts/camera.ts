/** The device's camera. */
import { LandlineError } from "./errors.js";
import type { Intrinsics } from "./types.js";

export interface CameraOptions {
  /** Ask for this device. Otherwise the one that looks away from the user. */
  deviceId?: string;
  /** What to ask for; the camera may give something else. */
  width?: number;
  height?: number;
}

export interface Camera {
  readonly stream: MediaStream;
  /** Playing; not part of the page unless you add it. */
  readonly video: HTMLVideoElement;
  /** Changes when the lens or the size changes: key for what is remembered about the focal length. */
  key(): string;
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

/** Opens a camera. Call it from a click or a tap: browsers ask the user. */
export async function camera(options: CameraOptions = {}): Promise<Camera> {
  const media = globalThis.navigator?.mediaDevices;
  if (!media?.getUserMedia) {
    if (globalThis.isSecureContext === false) {
      throw new LandlineError("camera-insecure", "browsers give the camera only to pages loaded over HTTPS or from this computer", "Open the page with https://, or use a picture or a video.");
    }
    throw new LandlineError("camera-unavailable", "this browser offers no camera", "Open the page in a browser rather than inside another app, or use a picture or a video.");
  }
  const { deviceId, width = 1280, height = 720 } = options;
  let stream: MediaStream;
  try {
    stream = await media.getUserMedia({
      audio: false,
      video: { width: { ideal: width }, height: { ideal: height }, ...(deviceId === undefined ? { facingMode: { ideal: "environment" } } : { deviceId: { exact: deviceId } }) },
    });
  } catch (error) {
    const known = problems[(error as Error).name];
    if (known) throw new LandlineError(known.code, known.message, known.hint, error);
    throw new LandlineError("camera-unavailable", `the camera cannot be opened: ${String((error as Error).message ?? error)}`, "Try again, or use a picture or a video.", error);
  }
  const video = document.createElement("video");
  video.muted = true;
  video.playsInline = true;
  video.srcObject = stream;
  try {
    await video.play();
  } catch (error) {
    stream.getTracks().forEach((track) => track.stop());
    throw new LandlineError("camera-unavailable", `the camera's picture cannot be shown: ${String((error as Error).message ?? error)}`, "Try again.", error);
  }
  return {
    stream,
    video,
    key(): string {
      const track = stream.getVideoTracks()[0];
      const settings = track?.getSettings() as (MediaTrackSettings & { zoom?: number }) | undefined;
      return [settings?.deviceId ?? "", track?.label ?? "", `${video.videoWidth}x${video.videoHeight}`, settings?.zoom ?? 1].join("|");
    },
    stop(): void {
      stream.getTracks().forEach((track) => track.stop());
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
