/** Words and numbers beside the picture. */
import { $ } from "./dom.js";
import { focalWords, numFocals } from "./focal.js";

const stageNames = [
  ["transfer", "Transfer"],
  ["preprocess", "Preparing"],
  ["features", "Points"],
  ["lines", "Lines"],
  ["regress", "Recognising"],
  ["solve", "Position"],
];

/** Why there is no position, and what to do about it. */
const reasonWords = {
  "few-features": ["Too little to see", "Point the camera at something with edges and texture, or add light."],
  "few-correspondences": ["Not this place?", "Hardly anything here looks like the taught scene. Turn around, or load the scene of this place."],
  "few-inliers": ["No position fits", "What is seen does not agree on one position. Move back, or show a larger part of the room."],
  degenerate: ["Too flat a view", "A single surface leaves the position open. Bring something else into view."],
  ambiguous: ["Two places look alike", "Several positions explain this picture. Show something that exists only once."],
  "other-place": ["Not this place", "What the scene should show is here from no position. Turn to a part that was taught, or load the scene of this place."],
  mirrored: ["Mirrored", "This fits only as seen in a mirror. Turn off the mirroring of the camera."],
  "focal-mismatch": ["Another focal length", "This picture is located with another focal length than the given one. Clear the field, or give that of this picture."],
  turned: ["Turned picture", "It is located once it is turned upright. Turn it, or save it with its orientation."],
  timeout: ["Ran out of time", "The search was cut short. Allow more time per frame, or use a smaller picture."],
};

const limitedWords = {
  lost: "position lost, looking again",
  jump: "the position jumped; waiting for agreement",
  "focal-uncertain": "the focal length is not certain yet",
};

export const ms = (value) => (value < 9.95 ? `${value.toFixed(1)} ms` : `${Math.round(value)} ms`);
export const bytes = (n) => (n < 1000 ? `${n} B` : n < 1e6 ? `${(n / 1e3).toFixed(0)} kB` : n < 1e9 ? `${(n / 1e6).toFixed(1)} MB` : `${(n / 1e9).toFixed(1)} GB`);

/** A length in words of the scene's unit. */
export function length(value, metric) {
  if (!metric) return `${value.toPrecision(3)} units`;
  const m = Math.abs(value);
  if (m < 0.01) return `${(value * 1000).toFixed(1)} mm`;
  return m < 1 ? `${(value * 100).toFixed(1)} cm` : `${value.toFixed(2)} m`;
}

let announcedAt = 0;
let announced = "";

/** The status line; read aloud when its first word changes, at most every three seconds. */
export function status(kind, word, detail) {
  $("status").dataset.kind = kind;
  $("status-word").textContent = word;
  $("status-detail").textContent = detail;
  const now = performance.now();
  if (word !== announced && now - announcedAt > 3000) {
    announced = word;
    announcedAt = now;
    $("announce").textContent = `${word}. ${detail}`;
  }
}

/** The result in words. `error` is set where the true pose is known. */
export function showResult(result, error) {
  const metric = result.units === "metres";
  const q = result.quality;
  if (result.located) {
    const parts = [];
    if (error) parts.push(`off by ${length(error.distance, metric)} and ${error.degrees.toFixed(2)}°`);
    else if (q.sigmaPosition !== undefined) parts.push(`± ${length(q.sigmaPosition, metric)}`);
    parts.push(`${q.pointInliers} points and ${q.lineInliers} lines agree`, ms(result.timingsMs.total));
    if (result.warning) parts.unshift("the given focal length does not fit, another was solved");
    if (result.state === "limited" && result.limited) parts.unshift(limitedWords[result.limited]);
    status(result.state === "limited" ? "warn" : "good", result.room ? `Located in ${roomName(result.room)}` : "Located", parts.join(" · "));
  } else {
    const [word, advice] = unknownRoom(result) ?? reasonWords[result.reason] ?? ["Not located", ""];
    status("bad", word, result.turnClockwiseDeg ? advice.replace("upright", `by ${result.turnClockwiseDeg}° clockwise`) : advice);
  }
  showStages(result.timingsMs);
  showFacts(result, metric, error);
}

/** What a room of a place is called. */
export const roomName = (room) => room.name ?? room.id;

/** What only places of many rooms say of a picture without a position. */
function unknownRoom({ rivals, missing }) {
  if (rivals) return ["Two rooms look alike", `This fits ${rivals.join(" and ")}. Show something that only one of them has.`];
  if (missing) return ["A room is missing", `It may be ${missing.join(" or ")}, which could not be loaded.`];
  return undefined;
}

function showStages(timings) {
  const root = $("stages");
  if (root.childElementCount === 0) {
    for (const [key, name] of stageNames) {
      const row = document.createElement("div");
      row.className = "stage-row";
      const label = document.createElement("span");
      label.textContent = name;
      const meter = document.createElement("meter");
      meter.min = 0;
      meter.dataset.stage = key;
      meter.setAttribute("aria-label", name);
      // No live region: it changes with every frame.
      const time = document.createElement("span");
      row.append(label, meter, time);
      root.append(row);
    }
  }
  const longest = Math.max(1, ...stageNames.map(([key]) => timings[key]));
  root.querySelectorAll("meter").forEach((meter) => {
    const value = timings[meter.dataset.stage];
    meter.max = longest;
    meter.value = value;
    meter.nextElementSibling.textContent = ms(value);
  });
  $("stage-total").textContent = `Together ${ms(timings.total)}, ${(1000 / timings.total).toFixed(1)} frames a second.`;
}

function showFacts(result, metric, error) {
  const q = result.quality;
  const k = result.intrinsics;
  const rows = [
    ["Points agree", `${q.pointInliers} of ${q.pointCorrespondences}`],
    ["Lines agree", `${q.lineInliers} of ${q.lineCorrespondences}`],
  ];
  rows.push(["Detected", `${q.keypoints} points, ${q.segments} lines`]);
  if (result.placement) {
    const triple = ({ x, y, z }) => [x, y, z].map((v) => v.toFixed(3)).join("  ");
    rows.unshift(["Position", triple(result.placement.position) + (metric ? " m" : " units")]);
    if (result.placementInPlace) rows.unshift(["In the place", triple(result.placementInPlace.position)]);
    if (result.room) rows.unshift(["Room", roomName(result.room)]);
    rows.push(["Error in picture", `${q.medianErrorPx.toFixed(2)} px median`]);
    if (q.sigmaPosition !== undefined) rows.push(["Uncertainty", `${length(q.sigmaPosition, metric)}, ${((q.sigmaRotationRad * 180) / Math.PI).toFixed(2)}°`]);
    rows.push(["Confidence", q.confidence.toFixed(2)]);
  }
  if (error) rows.push(["True error", `${length(error.distance, metric)}, ${error.degrees.toFixed(3)}°`]);
  rows.push(["Focal length", focalWords(k)]);
  rows.push(["Frame", `${result.frame.width} × ${result.frame.height}`]);
  facts($("facts"), rows);
}

/** Fills a definition list. */
export function facts(list, rows) {
  const nodes = rows.flatMap(([name, value]) => {
    const dt = document.createElement("dt");
    dt.textContent = name;
    const dd = document.createElement("dd");
    dd.textContent = value;
    return [dt, dd];
  });
  list.replaceChildren(...nodes);
}

/** Accuracy on pictures that the scene was not taught. */
function accuracy({ pictures, notLocated, medianPosition, medianRotationDeg }, metric) {
  const located = `${pictures - notLocated} of ${pictures} held-out pictures located`;
  return medianPosition === undefined ? located : `${length(medianPosition, metric)}, ${medianRotationDeg.toFixed(2)}° in the median; ${located}`;
}

/** What finds features, by the name that its authors gave it. */
export const extractorName = (kind) => ({ xfeat: "XFeat", "superpoint-v1": "SuperPoint" })[kind] ?? kind;

export function showScene(info, name) {
  const metric = info.units === "metres";
  const rows = [
    ["Name", name],
    ["Features", extractorName(info.extractor)],
    ["Size", bytes(info.bytes)],
    ["Units", metric ? "metres" : "unknown; lengths are in units of the scene"],
  ];
  if (info.heldOut) rows.push(["Accuracy", accuracy(info.heldOut, metric)]);
  if (info.licence) rows.push(["Licence", info.licence]);
  const made = new Date(info.created);
  if (!Number.isNaN(made.valueOf())) rows.push(["Made", made.toLocaleDateString("en-GB", { day: "numeric", month: "long", year: "numeric" })]);
  facts($("scene-facts"), rows);
}

/** One bar per file that is loading. */
export class LoadBars {
  #root = $("bars");
  #bars = new Map();

  reset() {
    this.#root.replaceChildren();
    this.#bars.clear();
  }

  update(event) {
    if (event.status === "download" || event.status === "done") {
      const bar = this.#bar(event.file);
      if (event.status === "done") {
        bar.progress.max = 1;
        bar.progress.value = 1;
        bar.amount.textContent = `${bytes(event.bytes)}${event.fromCache ? `, kept from last time${event.unchecked ? "; no connection to ask whether it is still right" : ""}` : ""}`;
      } else if (event.total > 0) {
        bar.progress.max = event.total;
        bar.progress.value = event.loaded;
        bar.amount.textContent = `${bytes(event.loaded)} of ${bytes(event.total)}`;
      } else {
        bar.progress.removeAttribute("value");
        bar.amount.textContent = bytes(event.loaded);
      }
    }
  }

  #bar(file) {
    let bar = this.#bars.get(file);
    if (bar) return bar;
    const root = document.createElement("div");
    root.className = "bar";
    const head = document.createElement("div");
    head.className = "bar-head";
    const name = document.createElement("span");
    name.textContent = { engine: "Engine", extractor: "Feature finder (for all places)", scene: "The place", place: "List of rooms", index: "What tells rooms apart" }[file];
    const amount = document.createElement("span");
    const progress = document.createElement("progress");
    progress.setAttribute("aria-label", name.textContent);
    head.append(name, amount);
    root.append(head, progress);
    this.#root.append(root);
    bar = { progress, amount };
    this.#bars.set(file, bar);
    return bar;
  }
}

/** Opens the dialog that says what happened and what to do. */
export function problem(error) {
  const title = {
    "camera-denied": "The camera is not allowed",
    "camera-unavailable": "No camera",
    "camera-busy": "The camera is busy",
    "camera-insecure": "The camera needs a secure page",
    "scene-corrupt": "This scene file cannot be read",
    "scene-version": "This scene file is of another version",
    "scene-extractor": "This scene needs another extractor",
    "asset-fetch": "A file could not be loaded",
    "asset-integrity": "A file is not what it should be",
    "asset-mime": "The engine could not be loaded",
    unsupported: "This browser cannot do it",
    "bad-input": "This cannot be used",
    "engine-version": "The engine and the page are of different versions",
    "engine-defect": "The engine stopped",
    "out-of-memory": "Out of memory",
  }[error?.code] ?? "Something went wrong";
  $("problem-title").textContent = title;
  $("problem-text").textContent = sentence(error?.message ?? String(error));
  $("problem-hint").textContent = error?.hint || "Load the page again; if this repeats, please report how to get here.";
  $("problem-code").textContent = error?.code ?? error?.name ?? "";
  const dialog = $("problem");
  if (!dialog.open) dialog.showModal();
}

export function sentence(text) {
  const capital = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(capital) ? capital : `${capital}.`;
}

/** What has been sent, in the badge and in the dialog. */
export function showPrivacy({ bytes: sent, requests, afterReady }) {
  $("bytes-sent").textContent = `${bytes(sent).replace(" B", sent === 1 ? " byte" : " bytes")} sent`;
  $("privacy").dataset.sent = sent > 0 ? "yes" : "no";
  facts($("privacy-facts"), [
    ["Sent", `${sent} bytes`],
    ["Files fetched", `${requests}, all from ${location.host}${afterReady > 0 ? `; ${afterReady} of them pictures and parts of the page that were asked for later` : ""}`],
    ["Kept here", `the files, and the focal lengths of ${numFocals()} cameras`],
  ]);
}
