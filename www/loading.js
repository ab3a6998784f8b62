/** Scenes: loading one, and what happens when that or a frame fails. */
import { Relocalizer } from "landline";
import { $ } from "./dom.js";
import { firstFetch } from "./first.js";
import { LoadBars, problem, sentence, showScene, status } from "./panels.js";
import { markReady } from "./privacy.js";
import { state, stopSource } from "./session.js";
import { clearStage, forgetPlace, showBackend } from "./stage.js";
import { setPlaying } from "./strip.js";

const bars = new LoadBars();
let again;

/** Words in the middle of the stage, in place of the picture. `retry` is what the button “Try again” does. */
export function showEmpty(title, note, { retry, cancel = false, steady = cancel } = {}) {
  clearStage();
  $("empty").hidden = false;
  // While it loads nothing moves, whatever comes and goes.
  $("empty").toggleAttribute("data-loading", steady);
  $("empty-title").textContent = title;
  $("empty-note").textContent = note;
  $("retry-load").hidden = !retry;
  $("cancel-load").hidden = !cancel;
  again = retry;
}

export const cancelLoading = () => state.loading?.abort();
export const retryLoading = () => void again?.();

/** Loads a scene in place of the present one, which stays when that fails. True when it is there. */
export const loadScene = (scene, name, isSample, retry = () => loadScene(scene, name, isSample)) =>
  takeUp({
    name,
    retry,
    make: (common) => Relocalizer.create({ ...common, scene, device: state.device }),
    taken: (relocalizer) => {
      state.scene = { name, isSample, again: () => loadScene(scene, name, isSample) };
      state.metric = relocalizer.scene.units === "metres";
      showScene(relocalizer.scene, name);
      if (isSample) showEmpty("Waiting for the first picture", "", { steady: true });
      else showEmpty("The scene is loaded", "Now choose a picture or a video of this place, or use the camera in it.");
    },
  });

/** Puts what `make` makes in place of the present relocalizer, which stays when that fails. True when it is there; `taken` shows it. */
export async function takeUp({ name, retry, make, taken }) {
  state.loading?.abort();
  const loading = new AbortController();
  state.loading = loading;
  await stopSource();
  const before = state.relocalizer;
  bars.reset();
  showEmpty(`Loading ${name}`, "Everything is loaded once and kept on this device.", { cancel: true });
  status("wait", "Loading", name);
  try {
    const relocalizer = await make({
      smoothing: $("smoothing").value,
      signal: loading.signal,
      fetch: firstFetch,
      onProgress: (event) => {
        if (state.loading !== loading) return;
        bars.update(event);
        if (event.status === "prepare") $("empty-note").textContent = "Preparing the networks…";
      },
    });
    if (loading.signal.aborted) {
      await relocalizer.dispose();
      return false;
    }
    state.leave?.();
    state.leave = undefined;
    state.relocalizer = relocalizer;
    await before?.dispose();
    forgetPlace();
    bars.reset();
    taken(relocalizer);
    showBackend(relocalizer);
    status("wait", "Ready", "Choose a picture, a video or the camera.");
    markReady();
    return true;
  } catch (fault) {
    const error = plainly(fault);
    bars.reset();
    if (loading.signal.aborted) {
      if (state.loading !== loading) return false;
      showEmpty("Cancelled", "Nothing was loaded.", { retry });
      status("warn", "Cancelled", "Try again, or drop a scene file.");
      return false;
    }
    const keeps = before !== undefined && state.relocalizer === before;
    const still = keeps && state.scene ? ` The scene from before (${state.scene.name}) is still in use: choose a picture, a video or the camera.` : "";
    showEmpty(keeps ? "The scene was not loaded" : "Not loaded", `${sentence(error.message)} ${error.hint ?? ""}${still}`, { retry });
    status("bad", "Not loaded", sentence(error.message));
    problem(error);
    return false;
  } finally {
    if (state.loading === loading) state.loading = undefined;
  }
}

/** What a file's checks say of its insides is for programs; that it is incomplete is for everybody. */
const plainly = (error) => (error.code === "scene-corrupt" && /truncated|damaged/.test(error.message) ? { code: error.code, message: "the file is cut off or damaged", hint: error.hint } : error);

/** A frame that could not be processed: says why, and replaces an engine that is broken. */
export function frameFailed(error, name) {
  status("bad", "Cannot use this", `${sentence(error.message)} ${error.hint ?? ""}`.trim());
  // A camera or a video goes on; of a picture that cannot be read there is nothing to show.
  if (!state.live || !state.result) showEmpty("Cannot use this", `${sentence(error.message)} ${error.hint ?? ""}`);
  $("stage-tag").hidden = !name;
  $("stage-tag").textContent = name;
  if (error.code !== "engine-defect" && error.code !== "disposed") return;
  problem(error);
  setPlaying(false);
  // The instance is lost, the page is not: load the same scene again.
  if (error.code === "engine-defect" && state.scene) void state.scene.again();
}
