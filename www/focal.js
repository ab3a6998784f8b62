/**
 * Focal lengths of this device's cameras, kept from visit to visit: the engine learns them from located frames, and with
 * a known one positions are right from the first frame on. They stay on this device and go with “Remove stored files”.
 */
const key = "landline-cameras";
/** Cameras that are kept; phones have a few lenses at a few sizes each. */
const maxCameras = 24;
/** Off once the visitor has had them removed: a camera that still runs would bring its own back with the next frame. */
let keeps = true;

function read() {
  try {
    return new Map(Object.entries(JSON.parse(localStorage.getItem(key) ?? "{}")));
  } catch {
    // No storage for this page, or something else wrote there: begin anew.
    return new Map();
  }
}

/** Tells the engine what an earlier visit learned of this camera. */
export async function recallFocal(relocalizer, camera) {
  const focalPerWidth = read().get(camera);
  if (typeof focalPerWidth !== "number") return;
  try {
    await relocalizer.recallCamera(camera, focalPerWidth);
  } catch {
    remove();
  }
}

/** Keeps what a result says about its camera, once the engine has learned it. */
export function keepFocal(result, camera) {
  const { source, fx, width, relativeSigma } = result.intrinsics;
  // Without a deviation it is no longer estimated: enough frames agreed on it.
  if (!keeps || !result.located || source !== "remembered" || relativeSigma !== undefined) return;
  const kept = read();
  const focalPerWidth = Number((fx / width).toPrecision(4));
  if (Math.abs(kept.get(camera) / focalPerWidth - 1) < 0.005) return;
  kept.delete(camera);
  kept.set(camera, focalPerWidth);
  for (const oldest of [...kept.keys()].slice(0, Math.max(0, kept.size - maxCameras))) kept.delete(oldest);
  try {
    localStorage.setItem(key, JSON.stringify(Object.fromEntries(kept)));
  } catch {
    // No room or no permission: the next visit learns it again.
  }
}

const sourceWords = {
  given: "given",
  track: "from the camera",
  exif: "from the picture’s EXIF",
  scene: "the scene’s own camera",
  remembered: "learned from earlier frames",
  estimated: "solved from this picture",
  assumed: "assumed; distances may be off",
};

/** The focal length of a result in words. One with a deviation was solved: what EXIF said is only where that began. */
export function focalWords({ fx, source, relativeSigma }) {
  const isSolved = relativeSigma !== undefined;
  const words = source === "exif" && isSolved ? "solved from this picture, EXIF as a start" : sourceWords[source];
  return `${fx.toFixed(1)} px, ${words}${isSolved ? ` (± ${(100 * relativeSigma).toFixed(1)} %)` : ""}`;
}

export const numFocals = () => read().size;

/** Removes what is kept; until the page is opened again nothing more is. */
export function forgetFocals() {
  keeps = false;
  remove();
}

function remove() {
  try {
    localStorage.removeItem(key);
  } catch {
    // There is nothing to remove where nothing can be stored.
  }
}
