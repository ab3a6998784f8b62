/** What buttons, fields and keys do. */
import { clearCache } from "landline";
import { $ } from "./dom.js";
import { wireDrop } from "./drop.js";
import { saveCsv, saveJson, stopEvaluation } from "./evaluation.js";
import { forgetFocals } from "./focal.js";
import { followAgain, holdVideo, startCamera } from "./live.js";
import { cancelLoading, retryLoading } from "./loading.js";
import { startFiles, startSample } from "./open.js";
import { problem } from "./panels.js";
import { go, showAgain } from "./playlist.js";
import { save } from "./report.js";
import { markSource, state } from "./session.js";
import { clearMap, mapView, redraw, toggleFollow } from "./stage.js";
import { setPlaying } from "./strip.js";

/** Connects everything. */
export function wire() {
  wireSources();
  wireOverlay();
  wireSettings();
  const clicks = {
    "cancel-load": cancelLoading,
    "retry-load": retryLoading,
    previous: () => go(state.index - 1),
    next: () => go(state.index + 1),
    play: togglePlay,
    "map-reset": () => mapView()?.reset(),
    "map-clear": clearMap,
    "map-follow": toggleFollow,
    "copy-json": copyJson,
    "save-csv": saveCsv,
    "save-json": saveJson,
    "stop-evaluation": stopEvaluation,
    "show-help": () => $("help").showModal(),
    privacy: () => $("privacy-details").showModal(),
    forget,
  };
  for (const [id, act] of Object.entries(clicks)) $(id).addEventListener("click", () => void act());
  wireShortcuts();
  $("strip").addEventListener("keydown", onStripKey);
  wireDrop((files) => startFiles(files, false));
  new ResizeObserver(redraw).observe($("overlay"));
}

function wireSources() {
  const pick = { open: "open-media", folder: "open-folder", scene: "open-scene" };
  const begin = (source) => {
    if (source === "sample") void startSample();
    else if (source === "camera") void startCamera();
    else if (source === "map") void mapThisPlace();
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
  $("camera-select").addEventListener("change", ({ target }) => void startCamera(target.value));
}

/** Mapping is loaded when it is asked for. */
async function mapThisPlace() {
  let flow;
  try {
    flow = await import("./mapping/flow.js");
  } catch (error) {
    problem({ code: "asset-fetch", message: "the mapping part of this page could not be loaded", hint: "It is loaded once, when it is first used: connect to the network, then try again.", cause: error });
    return;
  }
  await flow.openFlow();
}

function wireOverlay() {
  $("opacity").addEventListener("input", redraw);
  document.querySelectorAll("[data-layer]").forEach((box) => {
    state.layers[box.dataset.layer] = box.checked;
    box.addEventListener("change", () => {
      state.layers[box.dataset.layer] = box.checked;
      redraw();
    });
  });
}

function wireSettings() {
  $("device").value = state.device;
  $("device").addEventListener("change", async ({ target }) => {
    state.device = target.value;
    // A place of many rooms runs on the CPU, whatever is chosen.
    if (!state.scene || state.scene.isPlace) return;
    if (state.scene.isSample) await startSample({ reload: true });
    else if (await state.scene.again()) markSource("scene");
  });
  $("smoothing").addEventListener("change", ({ target }) => void state.relocalizer?.setOptions({ smoothing: target.value }));
  $("max-fps").addEventListener("change", followAgain);
  $("focal").addEventListener("change", showAgain);
}

function togglePlay() {
  setPlaying(!state.playing);
  holdVideo(state.playing);
}

async function copyJson() {
  const plain = JSON.stringify(state.result, (_, value) => (ArrayBuffer.isView(value) ? [...value] : value), 1);
  try {
    await navigator.clipboard.writeText(plain);
    $("copy-json").textContent = "Copied";
    setTimeout(() => ($("copy-json").textContent = "Copy as JSON"), 1500);
  } catch {
    save("landline-frame.json", plain, "application/json");
  }
}

/** Removes what the package and the page keep on this device. */
async function forget() {
  await clearCache();
  forgetFocals();
  if ("caches" in globalThis) for (const name of await caches.keys()) if (name.startsWith("landline")) await caches.delete(name);
  $("forget").textContent = "Removed";
}

const shortcutsKey = "landline-shortcuts";

/** Single keys can be switched off (WCAG 2.1.4); the choice is kept where something can be. */
function wireShortcuts() {
  const box = $("shortcuts");
  try {
    box.checked = localStorage.getItem(shortcutsKey) !== "off";
  } catch {
    // Nothing is kept for this page.
  }
  box.addEventListener("change", () => {
    try {
      localStorage.setItem(shortcutsKey, box.checked ? "on" : "off");
    } catch {
      // It holds until the page is closed.
    }
  });
  document.addEventListener("keydown", (event) => box.checked && onKey(event));
}

/** A list with the focus has its own keys, whether or not there are shortcuts. */
function onStripKey(event) {
  const last = state.playlist.length - 1;
  const to = { Home: 0, End: last, ArrowLeft: state.index - 1, ArrowRight: state.index + 1 }[event.key];
  if (to === undefined || last < 0) return;
  event.preventDefault();
  event.stopPropagation();
  go(to);
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
  else if (key === "m") mapView()?.reset();
  else if (key === "f") toggleFollow();
  else if (key === "?") $("help").showModal();
  else return;
  event.preventDefault();
}
