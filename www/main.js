/** The page: wires sources, engine, picture, map and panels together. */
import { onChange, markReady } from "./privacy.js";
import { Relocalizer, camera, checkSupport, clearCache, follow } from "landline";
import { clearOverlay, drawOverlay } from "./overlay.js";
import { SeenMap } from "./map.js";
import { wireDrop } from "./drop.js";
import { releasePlaylist, samplePlaylist, sortFiles } from "./sources.js";
import { addRow, save, showSummary } from "./report.js";
import { poseError, summary, toCsv } from "./evaluate.js";
import { LoadBars, problem, sentence, showPrivacy, showResult, showScene, status } from "./panels.js";

const $ = (id) => document.getElementById(id);
const query = new URLSearchParams(location.search);
const sampleBase = new URL("./scenes/sample/", document.baseURI);
/** Time that a sample picture stays, so that an eye can follow. */
const dwellMs = Number(query.get("dwell") ?? 1400);

const state = {
  relocalizer: undefined,
  /** Bytes or address of the scene, to load it again for another backend. */
  scene: undefined,
  metric: true,
  isSample: true,
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
const map = new SeenMap();
const bars = new LoadBars();
let view;
let viewLoading;

// Loading ------------------------------------------------------------------------------------------------------------

function showEmpty(title, note, { retry = false, cancel = false } = {}) {
  $("empty").hidden = false;
  $("empty-title").textContent = title;
  $("empty-note").textContent = note;
  $("retry-load").hidden = !retry;
  $("cancel-load").hidden = !cancel;
}

async function loadScene(scene, name, isSample) {
  state.loading?.abort();
  const loading = new AbortController();
  state.loading = loading;
  await stopSource();
  const before = state.relocalizer;
  bars.reset();
  showEmpty(`Loading ${name}`, "Everything is loaded once and kept on this device.", { cancel: true });
  status("wait", "Loading", name);
  try {
    const relocalizer = await Relocalizer.create({
      scene,
      device: state.device,
      smoothing: $("smoothing").value,
      signal: loading.signal,
      onProgress: (event) => {
        bars.update(event);
        if (event.status === "prepare") $("empty-note").textContent = "Preparing the networks…";
      },
    });
    if (loading.signal.aborted) {
      await relocalizer.dispose();
      return false;
    }
    state.relocalizer = relocalizer;
    state.scene = { source: scene, name, isSample };
    state.isSample = isSample;
    state.metric = relocalizer.scene.units === "metres";
    await before?.dispose();
    map.clear();
    state.truth = [];
    // Another place has another up and another extent.
    view?.dispose();
    view = viewLoading = undefined;
    $("map-note").hidden = false;
    showScene(relocalizer.scene, name);
    showBackend();
    $("empty").hidden = true;
    status("wait", "Ready", "Choose a picture, a video or the camera.");
    markReady();
    return true;
  } catch (error) {
    if (loading.signal.aborted) {
      showEmpty("Cancelled", "Nothing was loaded.", { retry: true });
      status("warn", "Cancelled", "Load the sample again, or drop a scene file.");
      return false;
    }
    bars.reset();
    const keeps = before !== undefined && state.relocalizer === before;
    showEmpty(keeps ? "The scene was not loaded" : "Not loaded", `${sentence(error.message)} ${error.hint ?? ""}`, { retry: true });
    status("bad", "Not loaded", sentence(error.message));
    problem(error);
    if (keeps && state.scene) {
      showEmpty("The scene was not loaded", `${sentence(error.message)} The scene from before (${state.scene.name}) is still in use.`, {});
    }
    return false;
  } finally {
    if (state.loading === loading) state.loading = undefined;
  }
}

/** Drivers go on at length; the whole text is in the badge's tooltip. */
const firstClause = (reason) => (reason ? sentence(reason.split(";")[0]) : "");

function showBackend() {
  const { backend, backendReason } = state.relocalizer;
  $("backend").textContent = backend === "webgpu" ? "WebGPU" : "CPU";
  $("backend").title = backendReason;
  $("device-note").textContent = firstClause(backendReason);
}

// Sources ------------------------------------------------------------------------------------------------------------

function markSource(name) {
  document.querySelectorAll("[data-source]").forEach((chip) => chip.setAttribute("aria-pressed", String(chip.dataset.source === name)));
  $("camera-choice").hidden = name !== "camera";
  $("strip").hidden = name === "camera" || name === "video";
}

async function stopSource() {
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
  $("copy-json").disabled = true;
  $("stage-tag").hidden = true;
  $("previous").disabled = $("next").disabled = true;
  if (state.relocalizer) await state.relocalizer.reset().catch(() => {});
}

/** True when there is an engine; otherwise says so. */
function haveEngine() {
  if (state.relocalizer) return true;
  problem({ code: "bad-input", message: "no scene is loaded yet", hint: "Wait for the sample, or drop a .landline file." });
  return false;
}

async function startSample() {
  if (!state.isSample || !state.relocalizer) {
    if (!(await loadScene(new URL("sample.landline", sampleBase).href, "the sample room", true))) return;
  } else {
    await stopSource();
  }
  markSource("sample");
  try {
    const playlist = await samplePlaylist(sampleBase);
    await startPlaylist(playlist, true);
  } catch (error) {
    status("bad", "No sample pictures", sentence(error.message));
    problem(error);
  }
}

async function startPlaylist(playlist, loop) {
  state.playlist = playlist;
  state.index = 0;
  state.rows = [];
  state.playing = playlist.length > 1;
  showPlaying();
  $("previous").disabled = $("next").disabled = playlist.length < 2;
  showStrip();
  const truths = playlist.flatMap(({ truth }) => (truth ? [positionOf(truth)] : []));
  state.truth = truths;
  view?.setTruth(truths);
  await play(loop);
}

function positionOf(m) {
  return { x: -(m[0] * m[3] + m[4] * m[7] + m[8] * m[11]), y: -(m[1] * m[3] + m[5] * m[7] + m[9] * m[11]), z: -(m[2] * m[3] + m[6] * m[7] + m[10] * m[11]) };
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
    if (state.index + 1 >= state.playlist.length && !loop) {
      state.playing = false;
      showPlaying();
      return;
    }
    state.index = (state.index + 1) % state.playlist.length;
  }
}

async function until(condition) {
  while (!condition()) await new Promise((done) => setTimeout(done, 40));
}

async function showPicture(index, run) {
  const item = state.playlist[index];
  markThumb(index);
  try {
    const { result, bitmap } = await locatePicture(item);
    if (run !== state.run) return bitmap.close();
    const error = result.placement && item.truth ? poseError(result.placement.cameraFromWorld, item.truth) : undefined;
    showFrame(result, bitmap, item.name, error, false);
    bitmap.close();
    const thumb = $("strip").children[index];
    if (thumb) thumb.dataset.result = result.located ? "located" : "not-located";
  } catch (error) {
    if (run !== state.run) return;
    handleFrameError(error, item.name);
  }
}

async function locatePicture(item) {
  const blob = await item.blob();
  let bitmap;
  try {
    bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  } catch (error) {
    throw Object.assign(new Error(`${item.name} cannot be decoded`), { code: "bad-input", hint: "Use a JPEG, PNG or WebP picture.", cause: error });
  }
  const intrinsics = intrinsicsFor(item, bitmap.width, bitmap.height);
  const result = await state.relocalizer.locate(intrinsics ? bitmap : blob, { include: ["points", "lines", "segments"], ...(intrinsics ? { intrinsics } : {}) });
  return { result, bitmap };
}

/** What the page knows about the focal length; otherwise the engine finds it. */
function intrinsicsFor(item, width, height) {
  const typed = Number($("focal").value);
  const f = typed > 0 ? typed : item?.focal;
  if (f) return { fx: f, fy: f, cx: width / 2, cy: height / 2, width, height };
  return item?.intrinsics;
}

function handleFrameError(error, name) {
  status("bad", "Cannot use this", sentence(error.message));
  if (error.code === "panicked" || error.code === "disposed") {
    problem(error);
    state.playing = false;
    showPlaying();
    // The instance is lost, the page is not: load the same scene again.
    if (error.code === "panicked" && state.scene) void loadScene(state.scene.source, state.scene.name, state.scene.isSample);
  } else {
    $("stage-tag").hidden = false;
    $("stage-tag").textContent = name;
  }
}

async function startFiles(files, wantFolder) {
  if (files.length === 0) return;
  const sorted = await sortFiles(files);
  if (sorted.scene) {
    const loaded = await loadScene(sorted.scene, sorted.scene.name, false);
    if (!loaded) return;
  }
  if (sorted.pictures.length === 0 && !sorted.video) {
    if (!sorted.scene) problem({ code: "bad-input", message: "there is no picture, video or scene file among these", hint: "Pictures: JPEG, PNG, WebP. Videos: MP4, WebM. Scenes: .landline." });
    else markSource("scene");
    return;
  }
  if (!haveEngine()) return;
  if (sorted.pictures.length === 0) return startVideo(sorted.video);
  await stopSource();
  markSource(wantFolder || sorted.poseFile ? "folder" : "open");
  $("empty").hidden = true;
  if (sorted.numTruth > 0 || wantFolder) await evaluateFolder(sorted);
  else await startPlaylist(sorted.pictures, false);
}

// Video and camera ---------------------------------------------------------------------------------------------------

async function startVideo(file) {
  if (!haveEngine()) return;
  await stopSource();
  markSource("video");
  document.querySelector('[data-source="open"]').setAttribute("aria-pressed", "true");
  const video = document.createElement("video");
  video.muted = true;
  video.playsInline = true;
  video.loop = true;
  const url = URL.createObjectURL(file);
  video.src = url;
  try {
    await video.play();
  } catch (error) {
    URL.revokeObjectURL(url);
    problem({ code: "bad-input", message: `${file.name} cannot be played here`, hint: "Use an MP4 (H.264) or WebM video.", cause: error });
    return;
  }
  $("empty").hidden = true;
  state.playing = true;
  showPlaying();
  runLive(video, `file:${file.name}`, { url, name: file.name });
}

async function startCamera(deviceId) {
  if (!haveEngine()) return;
  await stopSource();
  markSource("camera");
  status("wait", "Asking for the camera", "Answer the browser’s question.");
  let opened;
  try {
    opened = await camera(deviceId ? { deviceId } : {});
  } catch (error) {
    status("bad", "No camera", `${sentence(error.message)} ${error.hint ?? ""}`);
    markSource("");
    problem(error);
    return;
  }
  $("empty").hidden = true;
  await listCameras(opened);
  state.playing = true;
  showPlaying();
  opened.stream.getVideoTracks()[0]?.addEventListener("ended", () => {
    if (state.live?.camera !== opened) return;
    void stopSource();
    status("warn", "The camera was taken away", "Connect it again and choose “Use my camera”.");
  });
  runLive(opened.video, () => opened.key(), { camera: opened, name: "" });
}

async function listCameras(opened) {
  const devices = (await navigator.mediaDevices.enumerateDevices()).filter(({ kind }) => kind === "videoinput");
  const current = opened.stream.getVideoTracks()[0]?.getSettings().deviceId;
  $("camera-select").replaceChildren(...devices.map((device, i) => new Option(device.label || `Camera ${i + 1}`, device.deviceId, false, device.deviceId === current)));
  $("camera-choice").hidden = devices.length < 2;
}

function runLive(video, key, live) {
  const run = ++state.run;
  const typed = () => {
    const f = Number($("focal").value);
    return f > 0 && video.videoWidth > 0 ? intrinsicsFor(undefined, video.videoWidth, video.videoHeight) : undefined;
  };
  const following = follow(state.relocalizer, video, {
    camera: key,
    include: ["points", "lines", "segments"],
    maxFps: Number($("max-fps").value),
    get intrinsics() {
      return typed();
    },
    onResult: (result) => {
      if (run === state.run) showFrame(result, video, live.name, undefined, true);
    },
    onError: (error) => {
      if (run === state.run) handleFrameError(error, live.name);
    },
  });
  state.live = { ...live, video, following, key };
}

// Showing ------------------------------------------------------------------------------------------------------------

function showFrame(result, picture, name, error, continuous) {
  state.result = result;
  const canvas = $("picture");
  const { width, height } = result.frame;
  if (canvas.width !== width || canvas.height !== height) {
    canvas.width = width;
    canvas.height = height;
  }
  $("stage-frame").style.aspectRatio = `${width} / ${height}`;
  canvas.getContext("2d").drawImage(picture, 0, 0, width, height);
  map.add(result);
  redraw();
  $("stage-tag").hidden = !name;
  $("stage-tag").textContent = name;
  showResult(result, state.metric, error);
  showBackendOf(result);
  $("copy-json").disabled = false;
  $("map-counts").textContent = `Seen so far: ${map.numLines} lines, ${map.numPoints} points`;
  if (view || result.placement) void withView(result, (v) => v.show(result, map, canvas, continuous));
}

function showBackendOf(result) {
  const text = result.backend === "webgpu" ? "WebGPU" : "CPU";
  if ($("backend").textContent !== text) $("backend").textContent = text;
  if (result.backendReason !== $("backend").title) {
    $("backend").title = result.backendReason;
    $("device-note").textContent = firstClause(result.backendReason);
  }
}

function redraw() {
  if (state.result) drawOverlay($("overlay"), state.result, map, state.layers, Number($("opacity").value));
  else clearOverlay($("overlay"));
}

/** Calls with the 3D view; three.js is loaded with the first located frame, which also tells which way is up. */
async function withView(result, use) {
  viewLoading ??= (async () => {
    try {
      const { MapView } = await import("./view3d.js");
      view = new MapView($("map-frame"), state.relocalizer?.scene.up ?? upOf(result.placement.worldFromCamera));
      view.setTruth(state.truth);
      view.onFollowEnd = () => $("map-follow").setAttribute("aria-pressed", "false");
      $("map-note").hidden = true;
    } catch (error) {
      $("map-note").textContent = `The 3D view needs WebGL, which this browser does not give (${error.message}). Positions are listed under “This frame”.`;
    }
  })();
  await viewLoading;
  if (view) use(view);
}

/** Up in the world as a camera that is held upright sees it; of the axis it is close to, if there is one. */
function upOf(m) {
  const up = [-m[1], -m[5], -m[9]];
  const axis = up.findIndex((v) => Math.abs(v) > 0.85);
  const [x, y, z] = axis < 0 ? up : up.map((v, i) => (i === axis ? Math.sign(v) : 0));
  return { x, y, z };
}

function showStrip() {
  $("strip").replaceChildren(
    ...state.playlist.map((item, i) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "thumb";
      button.setAttribute("role", "option");
      button.setAttribute("aria-selected", "false");
      button.setAttribute("aria-label", item.name);
      button.tabIndex = -1;
      if (item.thumb) {
        const image = document.createElement("img");
        image.src = item.thumb;
        image.alt = "";
        image.loading = "lazy";
        image.decoding = "async";
        button.append(image);
      } else {
        button.textContent = String(i + 1);
      }
      button.addEventListener("click", () => go(i));
      return button;
    }),
  );
}

function markThumb(index) {
  [...$("strip").children].forEach((thumb, i) => thumb.setAttribute("aria-selected", String(i === index)));
  const thumb = $("strip").children[index];
  if (thumb) $("strip").scrollTo({ left: thumb.offsetLeft - $("strip").clientWidth / 2, behavior: "instant" });
}

function showPlaying() {
  $("play").setAttribute("aria-label", state.playing ? "Pause" : "Play");
  $("icon-pause").toggleAttribute("hidden", !state.playing);
  $("icon-play").toggleAttribute("hidden", state.playing);
}

/** Goes to a picture of the list and stays there. */
function go(index) {
  const count = state.playlist.length;
  if (count === 0) return;
  state.index = (index + count) % count;
  state.playing = false;
  showPlaying();
  void play(true);
}

function togglePlay() {
  state.playing = !state.playing;
  showPlaying();
  const { live } = state;
  if (live && !live.camera) void (state.playing ? live.video.play() : live.video.pause());
  else if (live?.camera) void (state.playing ? live.video.play() : live.video.pause());
}

// Evaluation ---------------------------------------------------------------------------------------------------------

async function evaluateFolder({ pictures, poseFile, numTruth, skippedLines }) {
  const run = ++state.run;
  state.playlist = pictures;
  state.rows = [];
  state.playing = true;
  showPlaying();
  showStrip();
  $("evaluation").hidden = false;
  $("evaluation-table").tBodies[0].replaceChildren();
  const about = poseFile
    ? `${numTruth} of ${pictures.length} pictures have a pose in ${poseFile}${skippedLines ? `; ${skippedLines} lines of it could not be read` : ""}.`
    : `No file of poses (a name with “pose”, ending in .txt) was among these, so errors cannot be given. Lines: name qw qx qy qz tx ty tz [focal].`;
  $("evaluation-note").textContent = about;
  const progress = $("evaluation-progress");
  progress.hidden = false;
  progress.max = pictures.length;
  $("stop-evaluation").hidden = false;
  state.truth = pictures.flatMap(({ truth }) => (truth ? [positionOf(truth)] : []));
  view?.setTruth(state.truth);
  for (const [i, item] of pictures.entries()) {
    await until(() => run !== state.run || (state.playing && !document.hidden));
    if (run !== state.run) break;
    state.index = i;
    markThumb(i);
    let row = { name: item.name, located: false, hasTruth: item.truth !== undefined, pointInliers: 0, lineInliers: 0, ms: 0, distance: NaN, degrees: NaN };
    try {
      const { result, bitmap } = await locatePicture(item);
      const error = result.placement && item.truth ? poseError(result.placement.cameraFromWorld, item.truth) : undefined;
      row = { ...row, located: result.located, pointInliers: result.quality.pointInliers, lineInliers: result.quality.lineInliers, ms: result.timingsMs.total, timings: result.timingsMs, ...(result.placement ? { cameraFromWorld: [...result.placement.cameraFromWorld] } : {}), ...(error ?? {}) };
      if (run === state.run) showFrame(result, bitmap, item.name, error, false);
      bitmap.close();
    } catch (error) {
      row.failed = error.message;
      handleFrameError(error, item.name);
      if (error.code === "panicked") break;
    }
    if (run !== state.run) break;
    state.rows.push(row);
    addRow(row, state.metric);
    progress.value = i + 1;
    if (i % 5 === 4 || i + 1 === pictures.length) showSummary(state.rows, state.metric);
  }
  progress.hidden = true;
  $("stop-evaluation").hidden = true;
  if (run === state.run) {
    showSummary(state.rows, state.metric);
    status("good", "Evaluated", `${state.rows.length} pictures.`);
    state.playing = false;
    showPlaying();
    $("previous").disabled = $("next").disabled = false;
    $("evaluation").dataset.done = "true";
  }
}

// Controls -----------------------------------------------------------------------------------------------------------

function wire() {
  const pick = { open: "open-media", folder: "open-folder", scene: "open-scene" };
  const begin = (source) => {
    if (source === "sample") void startSample();
    else if (source === "camera") void startCamera();
    else $(pick[source]).click();
  };
  document.querySelectorAll("[data-source]").forEach((chip) => chip.addEventListener("click", () => begin(chip.dataset.source)));
  for (const [id, folder] of [["open-media", false], ["open-folder", true], ["open-scene", false]]) {
    $(id).addEventListener("change", ({ target }) => {
      const files = [...target.files];
      target.value = "";
      void startFiles(files, folder);
    });
  }
  $("cancel-load").addEventListener("click", () => state.loading?.abort());
  $("retry-load").addEventListener("click", () => void startSample());
  $("previous").addEventListener("click", () => go(state.index - 1));
  $("next").addEventListener("click", () => go(state.index + 1));
  $("play").addEventListener("click", togglePlay);
  $("camera-select").addEventListener("change", ({ target }) => void startCamera(target.value));
  $("opacity").addEventListener("input", redraw);
  document.querySelectorAll("[data-layer]").forEach((box) => {
    state.layers[box.dataset.layer] = box.checked;
    box.addEventListener("change", () => {
      state.layers[box.dataset.layer] = box.checked;
      redraw();
    });
  });
  $("device").value = state.device;
  $("device").addEventListener("change", async ({ target }) => {
    state.device = target.value;
    if (!state.scene) return;
    const { source, name, isSample } = state.scene;
    if (isSample) {
      state.isSample = false; // forces the sample to load again
      await startSample();
    } else if (await loadScene(source, name, isSample)) {
      markSource("scene");
    }
  });
  $("smoothing").addEventListener("change", ({ target }) => void state.relocalizer?.setOptions({ smoothing: target.value }));
  $("max-fps").addEventListener("change", () => {
    const { live } = state;
    if (!live) return;
    live.following.stop();
    runLive(live.video, live.key, live);
  });
  $("focal").addEventListener("change", () => {
    if (!state.live && state.playlist.length > 0) void play(true);
  });
  $("map-reset").addEventListener("click", () => view?.reset());
  $("map-clear").addEventListener("click", () => {
    map.clear();
    view?.clear();
    $("map-counts").textContent = "Map: nothing seen yet";
    redraw();
  });
  $("map-follow").addEventListener("click", toggleFollow);
  $("copy-json").addEventListener("click", async () => {
    const plain = JSON.stringify(state.result, (_, value) => (ArrayBuffer.isView(value) ? [...value] : value), 1);
    try {
      await navigator.clipboard.writeText(plain);
      $("copy-json").textContent = "Copied";
    } catch {
      save("landline-frame.json", plain, "application/json");
    }
    setTimeout(() => ($("copy-json").textContent = "Copy as JSON"), 1500);
  });
  $("save-csv").addEventListener("click", () => save("landline-evaluation.csv", toCsv(state.rows), "text/csv"));
  $("save-json").addEventListener("click", () => save("landline-evaluation.json", JSON.stringify({ scene: state.relocalizer?.scene, backend: state.relocalizer?.backend, userAgent: navigator.userAgent, summary: summary(state.rows), rows: state.rows }, null, 1), "application/json"));
  $("stop-evaluation").addEventListener("click", () => (state.run += 1));
  $("show-help").addEventListener("click", () => $("help").showModal());
  $("privacy").addEventListener("click", () => $("privacy-details").showModal());
  $("forget").addEventListener("click", async () => {
    await clearCache();
    if ("caches" in globalThis) for (const name of await caches.keys()) if (name.startsWith("landline")) await caches.delete(name);
    $("forget").textContent = "Removed";
  });
  document.addEventListener("keydown", onKey);
  wireDrop((files) => startFiles(files, false));
  new ResizeObserver(redraw).observe($("overlay"));
}

function toggleFollow() {
  if (!view) return;
  view.following = !view.following;
  $("map-follow").setAttribute("aria-pressed", String(view.following));
}

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const { target, key } = event;
  if (target.matches("input:not([type=checkbox]):not([type=range]), select, textarea")) return;
  const layer = document.querySelectorAll("[data-layer]")[Number(key) - 1];
  if (layer && /^[1-9]$/.test(key)) layer.click();
  else if (key === " " && !target.matches("button, input, canvas")) togglePlay();
  else if (key === "ArrowLeft" && !target.matches("input, canvas")) go(state.index - 1);
  else if (key === "ArrowRight" && !target.matches("input, canvas")) go(state.index + 1);
  else if (key === "s") void startSample();
  else if (key === "c") void startCamera();
  else if (key === "o") $("open-media").click();
  else if (key === "m") view?.reset();
  else if (key === "f") toggleFollow();
  else if (key === "?") $("help").showModal();
  else return;
  event.preventDefault();
}

async function registerOffline() {
  if (!("serviceWorker" in navigator) || query.has("no-offline")) return;
  try {
    await navigator.serviceWorker.register("./sw.js");
  } catch {
    // Without it the page needs the network at the next visit; nothing else changes.
  }
}

// For tests and for curious people at the console.
globalThis.landlinePage = { state, map };
wire();
onChange(showPrivacy);
void registerOffline();
const support = await checkSupport();
if (!support.ok) {
  showEmpty("This browser cannot run Landline", support.reasons.join(" "));
  status("bad", "Not supported", support.reasons[0] ?? "");
} else {
  await startSample();
}
