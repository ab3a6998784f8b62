/** What the parts of the page share: the engine, what is being shown, and how that ends. */
import { $, query } from "./dom.js";
import { SeenMap } from "./map.js";
import { problem } from "./panels.js";
import { releasePlaylist } from "./sources.js";

export const map = new SeenMap();

export const state = {
  relocalizer: undefined,
  /** `{ name, isSample, isPlace, again }` of what is in use; `again` loads it once more. */
  scene: undefined,
  /** Called when something else is taken in its place. */
  leave: undefined,
  metric: true,
  device: query.get("device") ?? "auto",
  playlist: [],
  index: 0,
  playing: true,
  /** Grows whenever what is shown changes; late answers of an earlier run are dropped. */
  run: 0,
  loading: undefined,
  live: undefined,
  result: undefined,
  rows: [],
  /** Known positions, to be shown in the map. */
  truth: [],
  layers: {},
};

export function markSource(name) {
  document.querySelectorAll("[data-source]").forEach((chip) => chip.setAttribute("aria-pressed", String(chip.dataset.source === name)));
}

/** Ends the list, the video or the camera that is shown. */
export async function stopSource() {
  state.run += 1;
  const { live } = state;
  state.live = undefined;
  live?.following.stop();
  live?.camera?.stop();
  if (live?.url) URL.revokeObjectURL(live.url);
  live?.video.remove();
  releasePlaylist(state.playlist);
  state.playlist = [];
  state.result = undefined;
  $("strip").replaceChildren();
  $("strip").hidden = true;
  $("camera-choice").hidden = true;
  $("copy-json").disabled = true;
  $("stage-tag").hidden = true;
  $("previous").disabled = $("next").disabled = true;
  if (state.relocalizer) await state.relocalizer.reset().catch(() => {});
}

/** True when there is an engine; otherwise says so. */
export function haveEngine() {
  if (state.relocalizer) return true;
  problem({ code: "bad-input", message: "no scene is loaded yet", hint: "Wait for the sample, or drop a .landline file." });
  return false;
}
