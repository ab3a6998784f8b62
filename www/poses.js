/** Known poses from the files that data sets come with. The mapping engine reads them, as the native tool does. */
import { loadMapper } from "./mapper.js";

/** @typedef {{ cameraFromWorld: Float64Array, focal?: number, intrinsics?: object }} KnownPose */

/** A COLMAP model's points are large and tell nothing of pictures' poses. */
const mayHoldPoses = ({ name }) => (/\.(txt|poses)$/i.test(name) || /^(images|cameras)\.bin$/i.test(name)) && !/^points3D\./i.test(name);

/** Larger files take more memory than phones give. */
const mostBytes = 256 * 2 ** 20;

/** With its folders as far as they are known: those of a folder that was dropped, or chosen. */
const pathOf = (file) => file.droppedPath ?? (file.webkitRelativePath || file.name);

/** The list of this page's own sample: `{ camera, pictures: [{ name, cam_from_world }] }`. */
function ofSample(text) {
  const poses = new Map();
  let list;
  try {
    list = JSON.parse(text);
  } catch {
    return poses;
  }
  for (const { name, cam_from_world, camera } of Array.isArray(list?.pictures) ? list.pictures : []) {
    const pose = { cameraFromWorld: Float64Array.from((cam_from_world ?? []).flat()), intrinsics: camera ?? list.camera };
    if (pose.cameraFromWorld.length === 16 && pose.cameraFromWorld.every(Number.isFinite)) poses.set(name, pose);
  }
  return poses;
}

/**
 * What `files` know about `pictures`: a pose or nothing for each, where they are from in words, and sentences about what could
 * not be used. `load` gives the mapping engine.
 */
export async function readPoses(pictures, files, load = loadMapper) {
  const notes = [];
  const some = files.filter(mayHoldPoses).filter((file) => {
    if (file.size > mostBytes) notes.push(`${file.name} is too large for poses to be read from it here.`);
    return file.size <= mostBytes;
  });
  if (some.length > 0 && pictures.length > 0) {
    try {
      const mapper = await load();
      const read = await Promise.all(some.map(async (file) => ({ path: pathOf(file), bytes: new Uint8Array(await file.arrayBuffer()) })));
      const known = await mapper.readPoses(pictures.map(pathOf), read);
      notes.push(...known.notes);
      if (known.source !== "") return { poses: known.poses, source: known.source, notes };
    } catch (error) {
      notes.push(`Poses could not be read: ${error.message}. ${error.hint ?? ""}`.trim());
    }
  }
  for (const file of files.filter(({ name }) => name.endsWith(".json"))) {
    const found = ofSample(await file.text());
    if (found.size > 0) return { poses: pictures.map(({ name }) => found.get(name) ?? null), source: file.name, notes };
  }
  return { poses: pictures.map(() => null), source: "", notes };
}
