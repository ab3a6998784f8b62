/** Evaluation of a folder against known poses: every picture once, then the figures. */
import { $, until } from "./dom.js";
import { summary, toCsv } from "./evaluate.js";
import { frameFailed } from "./loading.js";
import { status } from "./panels.js";
import { errorOf, go, locatePicture } from "./playlist.js";
import { addRow, save, showSummary } from "./report.js";
import { state } from "./session.js";
import { showFrame, showTruth } from "./stage.js";
import { markResult, markThumb, setPlaying, showStrip } from "./strip.js";

/** Locates all pictures of sorted files, in their order. */
export async function evaluateFolder({ pictures, poseSource, numTruth, notes }) {
  const run = ++state.run;
  state.playlist = pictures;
  state.rows = [];
  setPlaying(true);
  showStrip(go);
  $("previous").disabled = $("next").disabled = true;
  const panel = $("evaluation");
  panel.hidden = false;
  panel.dataset.done = "false";
  $("evaluation-table").tBodies[0].replaceChildren();
  const about = poseSource
    ? `${numTruth} of ${pictures.length} pictures have a pose in ${poseSource}.`
    : "No poses were among these files, so errors cannot be given. Add a list of poses (a .txt file with lines “name qw qx qy qz tx ty tz [focal]”), a COLMAP model (images and cameras, .txt or .bin), or a .pose.txt beside each picture.";
  $("evaluation-note").textContent = [about, ...notes].join(" ");
  const progress = $("evaluation-progress");
  progress.hidden = false;
  progress.max = pictures.length;
  progress.value = 0;
  $("stop-evaluation").hidden = false;
  showTruth(pictures);
  panel.scrollIntoView({ block: "nearest" });
  for (const [i, item] of pictures.entries()) {
    await until(() => run !== state.run || (state.playing && !document.hidden));
    if (run !== state.run) break;
    state.index = i;
    markThumb(i);
    const row = await evaluate(item, i, run);
    if (run !== state.run || !row) break;
    state.rows.push(row);
    addRow(row, state.metric);
    progress.value = i + 1;
    if (i % 5 === 4 || i + 1 === pictures.length) showSummary(state.rows, state.metric);
  }
  progress.hidden = true;
  $("stop-evaluation").hidden = true;
  if (run !== state.run) return;
  showSummary(state.rows, state.metric);
  status("good", "Evaluated", `${state.rows.length} picture${state.rows.length === 1 ? "" : "s"}.`);
  setPlaying(false);
  $("previous").disabled = $("next").disabled = false;
  panel.dataset.done = "true";
}

/** One row of the table; `undefined` when the engine is lost. */
async function evaluate(item, index, run) {
  const row = { name: item.name, located: false, hasTruth: item.truth !== undefined, pointInliers: 0, lineInliers: 0, ms: 0, distance: NaN, degrees: NaN };
  try {
    const { result, bitmap } = await locatePicture(item);
    const error = errorOf(result, item);
    if (run === state.run) {
      showFrame(result, bitmap, item.name, error, false);
      markResult(index, result.located);
    }
    bitmap.close();
    const { located, quality, timingsMs, placement } = result;
    return {
      ...row,
      located,
      pointInliers: quality.pointInliers,
      lineInliers: quality.lineInliers,
      ms: timingsMs.total,
      timings: timingsMs,
      ...(placement ? { cameraFromWorld: [...placement.cameraFromWorld] } : {}),
      ...(error ?? {}),
    };
  } catch (error) {
    if (run === state.run) frameFailed(error, item.name);
    return error.code === "engine-defect" ? undefined : { ...row, failed: error.message };
  }
}

/** Stops where it is; the rows so far stay. */
export function stopEvaluation() {
  state.run += 1;
  setPlaying(false);
  $("previous").disabled = $("next").disabled = false;
  showSummary(state.rows, state.metric);
  status("warn", "Stopped", `${state.rows.length} pictures were evaluated.`);
}

export const saveCsv = () => save("landline-evaluation.csv", toCsv(state.rows), "text/csv");

export function saveJson() {
  const { relocalizer, rows } = state;
  save("landline-evaluation.json", JSON.stringify({ scene: relocalizer?.scene, backend: relocalizer?.backend, userAgent: navigator.userAgent, summary: summary(rows), rows }, null, 1), "application/json");
}
