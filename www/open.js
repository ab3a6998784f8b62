/** The ways in: the sample, chosen or dropped files, an address. */
import { query } from "./dom.js";
import { evaluateFolder } from "./evaluation.js";
import { sampleBase } from "./first.js";
import { startVideo } from "./live.js";
import { loadScene, showEmpty } from "./loading.js";
import { problem, sentence, status } from "./panels.js";
import { startPlaylist } from "./playlist.js";
import { haveEngine, markSource, state, stopSource } from "./session.js";
import { samplePlaylist, sortFiles } from "./sources.js";

/** What the page opens with: the sample, or the scene or the place of many rooms that its address names. */
export async function startFirst() {
  const [scene, place] = [query.get("scene"), query.get("place")];
  if (scene === null && place === null) return startSample();
  const url = new URL(place ?? scene, document.baseURI);
  if (url.origin !== location.origin) {
    const advice = place === null ? "Download the scene and drop it here, or choose “Own scene file”." : "Put the place beside this page.";
    showEmpty(`The ${place === null ? "scene" : "place"} is on another server`, `This page may talk to its own server only. ${advice}`);
    status("bad", "Not loaded", `The address names ${url.host}.`);
    return;
  }
  if (place !== null) return startPlace(url.href, query.get("room") ?? undefined);
  if (await loadScene(url.href, url.pathname.split("/").pop() || url.href, false)) markSource("scene");
}

/** Many rooms are loaded when they are asked for. */
async function startPlace(address, room) {
  let flow;
  try {
    flow = await import("./place/flow.js");
  } catch (error) {
    problem({ code: "asset-fetch", message: "the part of this page for places of many rooms could not be loaded", hint: "It is loaded once, when it is first used: connect to the network, then try again.", cause: error });
    return;
  }
  await flow.openPlace(address, room);
}

/** Loads the sample room if another scene is in use, and shows its pictures. */
export async function startSample({ reload = false } = {}) {
  // Beside the scene, so that its first picture is there when the engine is.
  const list = samplePlaylist(sampleBase);
  list.then(([first]) => first?.fetchEarly()).catch(() => undefined); // said below
  if (!state.scene?.isSample || !state.relocalizer || reload) {
    const url = new URL("sample.landline", sampleBase);
    if (!(await loadScene(url.href, "the sample room", true, startSample))) return;
  } else {
    await stopSource();
  }
  markSource("sample");
  const { run } = state;
  try {
    const playlist = await list;
    if (run === state.run) await startPlaylist(playlist, true);
  } catch (error) {
    status("bad", "No sample pictures", `${sentence(error.message)} ${error.hint ?? ""}`.trim());
    problem(error);
  }
}

/** Takes files of any kind; `wantFolder` asks for an evaluation even without poses. */
export async function startFiles(files, wantFolder) {
  if (files.length === 0) return;
  const sorted = await sortFiles(files);
  if (sorted.scene && !(await loadScene(sorted.scene, sorted.scene.name, false))) return;
  if (sorted.pictures.length === 0 && !sorted.video) {
    if (sorted.scene) markSource("scene");
    else problem({ code: "bad-input", message: "there is no picture, video or scene file among these", hint: "Pictures: JPEG, PNG, WebP. Videos: MP4, WebM. Scenes: .landline." });
    return;
  }
  if (!haveEngine()) return;
  if (sorted.pictures.length === 0) return startVideo(sorted.video);
  await stopSource();
  const evaluates = sorted.numTruth > 0 || wantFolder;
  markSource(evaluates ? "folder" : "open");
  if (evaluates) await evaluateFolder(sorted);
  else await startPlaylist(sorted.pictures, false);
}
