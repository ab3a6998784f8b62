/** Everything that can go wrong, as stable codes. "No position found" is not among them: that is a result. */
export type LandlineErrorCode =
  /** The browser lacks something that is needed; `message` says what. */
  | "unsupported"
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
  | "camera-unavailable"
  | "camera-denied"
  | "camera-busy"
  | "camera-insecure"
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

/** What helps when the place that raised an error knew nothing better. */
const hints: Record<LandlineErrorCode, string> = {
  unsupported: "Update the browser, or use another one.",
  "asset-fetch": "Check the connection and the address, then try again.",
  "asset-mime": "Check that the package's files are served as they are.",
  "asset-integrity": "Load the file again, or correct the expected checksum.",
  "scene-version": "Update this page, or export the scene again with a matching version of the landline tool.",
  "scene-corrupt": "Choose a file that ends in .landline, or export or download it again.",
  "scene-extractor": "Load the scene with the extractor it names, or teach the scene again with this one.",
  "extractor-corrupt": "Load the extractor's file again; clear this site's cache if it keeps failing.",
  "out-of-memory": "Close other tabs, or use smaller pictures.",
  "bad-input": "Correct the argument that the message names.",
  "camera-unavailable": "Connect a camera, or use a picture or a video.",
  "camera-denied": "Allow the camera in the browser's settings for this page, then try again.",
  "camera-busy": "Close the other program or tab that uses the camera, then try again.",
  "camera-insecure": "Open the page with https://.",
  "engine-version": "Reload the page without its cache, and serve all files of one version of the package.",
  "engine-defect": "Create the relocalizer again; please report how to repeat this.",
  disposed: "Create a new relocalizer.",
  "not-enough-pictures": "Film on: thirty pictures and more make a map.",
  "no-model": "Film again: walk sideways, slowly, with light, and keep half of what you saw in view.",
  aborted: "Start again where you want to.",
};

/** Every error that this package raises itself. Cancelling by a signal rejects with the signal's own reason. */
export class LandlineError extends Error {
  override readonly name = "LandlineError";
  /** Stable; made for `switch`. */
  readonly code: LandlineErrorCode;
  /** What the reader can do about it; never empty. */
  readonly hint: string;

  constructor(code: LandlineErrorCode, message: string, hint = "", cause?: unknown) {
    super(message, cause === undefined ? undefined : { cause });
    this.code = code;
    this.hint = hint || hints[code];
  }
}

/** The fields of an error that survive a trip between threads. */
export interface PlainError {
  code: string;
  message: string;
  hint: string;
}

/** Makes a `LandlineError` from anything thrown by the engine or the other thread. */
export function asLandlineError(thrown: unknown): LandlineError {
  if (thrown instanceof LandlineError) return thrown;
  const fields = thrown as Partial<PlainError> | null | undefined;
  const message = typeof fields?.message === "string" ? fields.message : String(thrown);
  if (typeof fields?.code === "string" && fields.code in hints) {
    return new LandlineError(fields.code as LandlineErrorCode, message, fields.hint, thrown);
  }
  // A trap leaves the wasm instance in an unknown state: nothing that it returns afterwards can be trusted.
  if (typeof WebAssembly !== "undefined" && thrown instanceof WebAssembly.RuntimeError) {
    return new LandlineError("engine-defect", `the engine stopped: ${message}`, "", thrown);
  }
  if (thrown instanceof RangeError && /memory|allocation/i.test(message)) {
    return new LandlineError("out-of-memory", message, "", thrown);
  }
  return new LandlineError("engine-defect", message, "", thrown);
}

/** The opposite of `asLandlineError`, for messages between threads. */
export function plainError(thrown: unknown): PlainError {
  const error = asLandlineError(thrown);
  return { code: error.code, message: error.message, hint: error.hint };
}
