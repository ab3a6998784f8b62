/** One result on the page: the picture with its overlay, the numbers, the map. */
import { invertRigid, project } from "landline";
import { $ } from "./dom.js";
import { clearOverlay, drawOverlay } from "./overlay.js";
import { showResult } from "./panels.js";
import { map, state } from "./session.js";

let view;
let viewLoading;

/** The 3D view, once it is there. */
export const mapView = () => view;

/** Shows a result; `error` is set where the true pose is known, `continuous` for the frames of one moving camera. */
export function showFrame(result, picture, name, error, continuous) {
  state.result = state.answer = result;
  $("empty").hidden = true;
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
  showResult(result, error);
  showBackend(result);
  $("copy-json").disabled = false;
  showCounts();
  if (view || result.placement) void withView(result, (v) => v.show(result, map, canvas, continuous));
}

/** What the relocalizer found in an earlier picture than the one that is shown: numbers and map, nothing is drawn over the picture. */
export function showAnswer(result) {
  state.answer = result;
  map.add(result);
  showResult(result);
  showBackend(result);
  $("copy-json").disabled = false;
  showCounts();
  if (view || result.placement) void withView(result, (v) => v.show(result, map, $("picture"), true));
}

/** A frame between answers: its own picture, and over it what the last answer saw, where this frame's position puts it. */
export function showTracked(tracked, tag) {
  const answer = state.answer ?? state.result;
  const { frame } = tracked;
  const canvas = $("picture");
  if (canvas.width !== frame.width || canvas.height !== frame.height) {
    [canvas.width, canvas.height] = [frame.width, frame.height];
    $("stage-frame").style.aspectRatio = `${frame.width} / ${frame.height}`;
  }
  frame.draw(canvas.getContext("2d"));
  const { placement, intrinsics = answer.intrinsics } = tracked;
  const size = { width: frame.width, height: frame.height };
  // Pixels of the answer belong to its own picture; world points can be put where they are now.
  state.result = {
    ...answer,
    located: tracked.located,
    frame: size,
    intrinsics,
    placement,
    points: placement && answer.points ? seenNow(answer.points, placement, intrinsics) : undefined,
    segments: undefined,
  };
  $("stage-tag").hidden = !tag;
  $("stage-tag").textContent = tag;
  redraw();
}

/** Agreeing points where a position puts them; what is behind the camera lies outside. */
function seenNow(points, placement, intrinsics) {
  const pixels = new Float32Array(points.pixels.length).fill(-99);
  for (let i = 0; i < points.isInlier.length; i++) {
    if (points.isInlier[i]) pixels.set(project(placement, intrinsics, points.world.subarray(3 * i, 3 * i + 3)) ?? [-99, -99], 2 * i);
  }
  return { ...points, pixels };
}

/** Draws the overlay again, with other layers or for another size of the page. */
export function redraw() {
  if (state.result) drawOverlay($("overlay"), state.result, map, state.layers, Number($("opacity").value));
  else clearOverlay($("overlay"));
}

/** Takes the picture away, with what was drawn over it and said of it: it must not stand under another name. */
export function clearStage() {
  state.result = state.answer = undefined;
  const canvas = $("picture");
  canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
  clearOverlay($("overlay"));
  $("facts").replaceChildren();
  $("copy-json").disabled = true;
}

/** Drivers go on at length; the whole text is in the badge's tooltip. */
const firstClause = (reason) => (reason ? `${reason.charAt(0).toUpperCase()}${reason.slice(1).split(";")[0].replace(/[.]?$/, ".")}` : "");

/** What executes the networks and why; of a result or of the engine. */
export function showBackend({ backend, backendReason }) {
  const badge = $("backend");
  const text = backend === "webgpu" ? "WebGPU" : "CPU";
  if (badge.textContent === text && badge.title === backendReason) return;
  badge.textContent = text;
  badge.title = backendReason;
  $("device-note").textContent = firstClause(backendReason);
}

function showCounts() {
  const known = state.truth.length > 0 ? ". Grey: known camera positions" : "";
  $("map-counts").textContent = map.numLines + map.numPoints === 0 ? "Map: nothing seen yet" : `Seen so far: ${map.numLines} lines, ${map.numPoints} points${known}`;
}

/** Calls with the 3D view; three.js is loaded with the first located frame, which also tells which way is up. */
async function withView(result, use) {
  viewLoading ??= (async () => {
    $("map-note").textContent = "Loading the 3D view…";
    try {
      const { MapView } = await import("./view3d.js");
      view = new MapView($("map-frame"), state.relocalizer?.scene?.up ?? upOf(result.placement.worldFromCamera));
      view.setTruth(state.truth);
      view.onFollowEnd = () => $("map-follow").setAttribute("aria-pressed", "false");
      $("map-note").hidden = true;
    } catch (error) {
      $("map-note").textContent = `The 3D view needs WebGL, which this browser does not give (${error.message}). Turn on hardware acceleration in its settings, or read positions under “This frame”.`;
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

/** Known positions of a list's cameras, for comparison. */
export function showTruth(playlist) {
  state.truth = playlist.flatMap(({ truth }) => (truth ? [positionOf(truth)] : []));
  view?.setTruth(state.truth);
}

function positionOf(cameraFromWorld) {
  const [, , , x, , , , y, , , , z] = invertRigid(cameraFromWorld);
  return { x, y, z };
}

/** Forgets what was seen. */
export function clearMap() {
  map.clear();
  view?.clear();
  showCounts();
  redraw();
}

/** Makes room for another place, which has another up and another extent. */
export function forgetPlace() {
  map.clear();
  state.truth = [];
  showCounts();
  view?.dispose();
  view = viewLoading = undefined;
  $("map-note").hidden = false;
  $("map-note").textContent = "The map appears with the first located picture.";
  $("map-follow").setAttribute("aria-pressed", "false");
}

/** Turns following on or off. */
export function toggleFollow() {
  if (!view) return;
  view.following = !view.following;
  $("map-follow").setAttribute("aria-pressed", String(view.following));
}
