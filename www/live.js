/** A video file or the camera: always the newest frame. */
import { camera, follow } from "landline";
import { $ } from "./dom.js";
import { keepFocal, recallFocal } from "./focal.js";
import { frameFailed, showEmpty } from "./loading.js";
import { problem, sentence, status } from "./panels.js";
import { intrinsicsFor } from "./playlist.js";
import { haveEngine, markSource, state, stopSource } from "./session.js";
import { showAnswer, showFrame, showTracked } from "./stage.js";
import { setPlaying } from "./strip.js";

export async function startVideo(file) {
  if (!haveEngine()) return;
  await stopSource();
  markSource("open");
  const run = state.run;
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
    if (run !== state.run) return;
    const message = file.size === 0 ? `“${file.name}” is empty` : `“${file.name}” cannot be played here`;
    const hint = file.size === 0 ? "Copy or download it again." : "Use an MP4 (H.264) or WebM video.";
    showEmpty("The video cannot be played", `${message}. ${hint}`);
    status("bad", "Cannot use this", `${message}. ${hint}`);
    problem({ code: "bad-input", message, hint, cause: error });
    return;
  }
  if (run !== state.run) return URL.revokeObjectURL(url);
  begin(video, `file:${file.name}`, { url, name: file.name });
}

export async function startCamera(deviceId) {
  if (!haveEngine()) return;
  await stopSource();
  markSource("camera");
  const run = state.run;
  showEmpty("Asking for the camera", "Answer the browser’s question. Pictures stay on this device.");
  status("wait", "Asking for the camera", "Answer the browser’s question.");
  let opened;
  try {
    opened = await camera(deviceId ? { deviceId } : {});
  } catch (error) {
    if (run !== state.run) return;
    const words = `${sentence(error.message)} ${error.hint ?? ""}`;
    status("bad", "No camera", words);
    showEmpty("No camera", words, { retry: () => startCamera(deviceId) });
    markSource("");
    problem(error);
    return;
  }
  // Something else was chosen while the browser asked.
  if (run !== state.run) return opened.stop();
  await listCameras(opened);
  opened.stream.getVideoTracks()[0]?.addEventListener("ended", () => {
    if (state.live?.camera !== opened) return;
    void stopSource();
    status("warn", "The camera was taken away", "Connect it again and choose “Use my camera”.");
  });
  await recallFocal(state.relocalizer, opened.key());
  begin(opened.video, () => opened.key(), { camera: opened, name: "" });
}

function begin(video, key, live) {
  showEmpty("Waiting for the first picture", "");
  status("wait", "Searching", "Looking for the first position.");
  setPlaying(true);
  run(video, key, live);
}

/** Names are known only after permission. */
async function listCameras(opened) {
  const devices = (await navigator.mediaDevices.enumerateDevices()).filter(({ kind }) => kind === "videoinput");
  const current = opened.stream.getVideoTracks()[0]?.getSettings().deviceId;
  $("camera-select").replaceChildren(...devices.map((device, i) => new Option(device.label || `Camera ${i + 1}`, device.deviceId, false, device.deviceId === current)));
  $("camera-choice").hidden = devices.length < 2;
}

/** Why a frame has no position, while the last one that had is not long ago. */
const lostWords = {
  "excessive-motion": "Too fast to follow: hold still for a moment.",
  "insufficient-features": "What was followed is not found again: hold still, or show edges and patterns.",
  "out-of-view": "What was followed is out of view: turn back a little, or wait.",
  jump: "The position jumped: waiting for a second answer.",
  frozen: "The camera gives the same picture again and again.",
  resized: "The picture has changed its size.",
};

/** The frame on the page has no position, whatever an earlier one had. */
const sayLost = ({ limited }) => status("warn", "Searching", lostWords[limited] ?? "Looking for the position.");

/** How many frames a second have a position, and where the newest came from. */
class Rate {
  #times = [];

  count(result) {
    const now = performance.now();
    this.#times = this.#times.filter((at) => now - at < 1000);
    if (result.located) this.#times.push(now);
  }

  words(result) {
    if (!result.located) return "no position";
    // A video that began anew is at an earlier time than the answer that it is tracked from.
    const from = result.by === "localization" ? "located" : result.age.ms < 0 ? "tracked" : `tracked for ${(result.age.ms / 1000).toFixed(1)} s`;
    return `${this.#times.length} a second · ${from} · ${result.trackingMs.toFixed(1)} ms`;
  }
}

function run(video, key, live) {
  const mine = ++state.run;
  const rate = new Rate();
  let newest;
  state.result = undefined;
  const following = follow(state.relocalizer, video, {
    camera: key,
    include: ["points", "lines", "segments"],
    maxLocalizationsPerSecond: Number($("max-fps").value),
    /** Read for each frame: the focal length may be typed at any time. */
    get intrinsics() {
      return Number($("focal").value) > 0 && video.videoWidth > 0 ? intrinsicsFor(undefined, video.videoWidth, video.videoHeight) : undefined;
    },
    /** Every frame: its own picture, never another's. */
    onResult: (result) => {
      if (mine !== state.run) return;
      rate.count(result);
      newest = result;
      if (state.result) {
        showTracked(result, `${live.name ? `${live.name} · ` : ""}${rate.words(result)}`);
        // Why an answer has no position is said with the answer, and better.
        if (!result.located && state.answer?.located) sayLost(result);
      } else if (result.state === "searching") status("wait", "Searching", "Looking for the first position.");
    },
    /** Now and then: what the relocalizer found, in the picture that it was given. */
    onAnswer: ({ result, frame }) => {
      if (mine !== state.run) return;
      if (state.result) {
        showAnswer(result);
        if (result.located && newest && !newest.located) sayLost(newest);
      } else showFrame(result, frame.source, live.name, undefined, true);
      if (live.camera) keepFocal(result, key());
    },
    onError: (error) => {
      if (mine === state.run) frameFailed(error, live.name);
    },
  });
  state.live = { ...live, video, following, key };
}

/** Follows the same video or camera with changed settings. */
export function followAgain() {
  const { live } = state;
  if (!live) return;
  live.following.stop();
  run(live.video, live.key, live);
}

/** Lets the video go on, or holds it. */
export function holdVideo(playing) {
  const { live } = state;
  if (live) void (playing ? live.video.play() : live.video.pause());
}
