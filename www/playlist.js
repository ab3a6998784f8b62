/** Pictures that are located one after another. */
import { $, query, until } from "./dom.js";
import { poseError } from "./evaluate.js";
import { frameFailed } from "./loading.js";
import { state } from "./session.js";
import { showFrame, showTruth } from "./stage.js";
import { loadThumbs, markNext, markResult, markThumb, setPlaying, showStrip } from "./strip.js";

/** Time that a picture stays, so that an eye can follow. */
const dwellMs = Number(query.get("dwell") ?? 1400);
/** Who asked for less motion gets the next picture on demand only. */
const calm = matchMedia("(prefers-reduced-motion: reduce)");

/** Shows a list; with `loop` it begins again at its end. */
export async function startPlaylist(playlist, loop) {
  state.playlist = playlist;
  state.index = 0;
  setPlaying(playlist.length > 1 && !calm.matches);
  showStrip(go);
  showTruth(playlist);
  await play(loop);
}

/** Locates one picture after another. */
async function play(loop) {
  const run = ++state.run;
  for (;;) {
    if (run !== state.run || state.playlist.length === 0) return;
    const started = performance.now();
    await showPicture(state.index, run);
    if (run !== state.run) return;
    await until(() => run !== state.run || (state.playing && !document.hidden && performance.now() - started >= dwellMs));
    if (run !== state.run) return;
    if (state.index + 1 >= state.playlist.length && !loop) return setPlaying(false);
    state.index = (state.index + 1) % state.playlist.length;
  }
}

async function showPicture(index, run) {
  const item = state.playlist[index];
  markNext(index);
  try {
    const { result, bitmap } = await locatePicture(item);
    if (run === state.run) {
      markThumb(index);
      showFrame(result, bitmap, item.name, errorOf(result, item), false);
      markResult(index, result.located);
    }
    bitmap.close();
  } catch (error) {
    if (run !== state.run) return;
    markThumb(index);
    frameFailed(error, item.name);
  } finally {
    loadThumbs();
  }
}

/** Decodes and locates one picture of a list; the bitmap is the caller's to close. */
export async function locatePicture(item) {
  const blob = await item.blob();
  let bitmap;
  try {
    bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (error) {
    const [message, hint] = blob.size === 0 ? ["is empty", "Copy or download it again."] : ["cannot be decoded: it is of another kind, or damaged", "Use a JPEG, PNG or WebP picture."];
    throw Object.assign(new Error(`“${item.name}” ${message}`), { code: "bad-input", hint, cause: error });
  }
  const intrinsics = intrinsicsFor(item, bitmap.width, bitmap.height);
  const include = ["points", "lines", "segments"];
  // Without intrinsics the engine gets the file itself, for its EXIF block.
  // A place of many rooms has no one scene to explain a picture by.
  const explain = state.scene?.isPlace ? {} : { explain: true };
  const result = await state.relocalizer.locate(intrinsics ? bitmap : blob, { include, ...explain, ...(intrinsics ? { intrinsics } : {}) });
  return { result, bitmap };
}

/** Error of a result against the item's known pose, where both are there. */
export function errorOf(result, item) {
  return result.placement && item.truth ? poseError(result.placement.cameraFromWorld, item.truth) : undefined;
}

/** What the page knows about the focal length; otherwise the engine finds it. */
export function intrinsicsFor(item, width, height) {
  const typed = Number($("focal").value);
  const f = typed > 0 ? typed : item?.focal;
  if (f) return { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height };
  return item?.intrinsics;
}

/** Goes to a picture of the list and stays there. */
export function go(index) {
  const count = state.playlist.length;
  if (count === 0) return;
  state.index = (index + count) % count;
  setPlaying(false);
  void play(true);
}

/** Locates the present picture again, for changed settings. */
export function showAgain() {
  if (!state.live && state.playlist.length > 0) void play(true);
}
