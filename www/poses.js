/** Known poses from the files that data sets come with. All are turned into `cameraFromWorld`, row-major, here. */
import { invertRigid } from "landline";

/** @typedef {{ cameraFromWorld: Float64Array, focal?: number, intrinsics?: object }} KnownPose */

/** Rotation of a quaternion and a translation as row-major 4x4. */
export function fromQuaternion(w, x, y, z, tx, ty, tz) {
  const n = Math.hypot(w, x, y, z);
  [w, x, y, z] = [w / n, x / n, y / n, z / n];
  return Float64Array.of(
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), tx,
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x), ty,
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y), tz,
    0, 0, 0, 1,
  );
}

const baseName = (path) => path.split("/").pop();
/** `frame-000012` of `frame-000012.color.png` and of `frame-000012.pose.txt`. */
const stem = (name) => name.replace(/\.pose\.txt$/, "").replace(/(\.(color|rgb))?\.[^.]+$/, "");
const lines = (text) => text.split(/\r?\n/).map((line) => line.trim());
const usable = (pose) => pose.cameraFromWorld.every(Number.isFinite);

/**
 * A list: lines `name qw qx qy qz tx ty tz [f]`, world to camera, as COLMAP and its relatives write them; or a name and
 * 16 numbers, a row-major camera-to-world matrix. Lines that are neither are counted.
 */
export function parseList(text) {
  const poses = new Map();
  let skipped = 0;
  for (const line of lines(text)) {
    const [name, ...rest] = line.split(/\s+/);
    if (rest.length === 0 || name.startsWith("#")) continue;
    const numbers = rest.map(Number);
    let pose;
    if (numbers.length === 16) pose = { cameraFromWorld: invertRigid(numbers) };
    else if (numbers.length === 7) pose = { cameraFromWorld: fromQuaternion(...numbers) };
    else if (numbers.length === 8 && numbers[7] > 0) pose = { cameraFromWorld: fromQuaternion(...numbers.slice(0, 7)), focal: numbers[7] };
    if (pose && usable(pose)) poses.set(baseName(name), pose);
    else skipped += 1;
  }
  return { poses, skipped };
}

/** COLMAP's `images.txt` with the cameras of `cameras.txt`: two lines per picture, the second of which may be empty. */
export function parseColmap(text, cameras = new Map()) {
  const poses = new Map();
  let skipped = 0;
  const all = lines(text).filter((line) => !line.startsWith("#"));
  for (let i = 0; i < all.length; i++) {
    const parts = all[i].split(/\s+/);
    if (all[i] === "") continue;
    i += 1;
    const pose = { cameraFromWorld: fromQuaternion(...parts.slice(1, 8).map(Number)) };
    const intrinsics = cameras.get(parts[8]);
    if (parts.length >= 10 && usable(pose)) poses.set(baseName(parts.slice(9).join(" ")), { ...pose, ...(intrinsics ? { intrinsics } : {}) });
    else skipped += 1;
  }
  return { poses, skipped };
}

/** Where the pinhole part of COLMAP's models has its numbers: fx, fy, cx, cy. */
const pinholes = { SIMPLE_PINHOLE: [0, 0, 1, 2], PINHOLE: [0, 1, 2, 3], SIMPLE_RADIAL: [0, 0, 1, 2], RADIAL: [0, 0, 1, 2], OPENCV: [0, 1, 2, 3] };

/** COLMAP's `cameras.txt`, lens distortion left out; `ignored` counts cameras that have some or are of another model. */
export function parseCameras(text) {
  const cameras = new Map();
  let ignored = 0;
  for (const line of lines(text)) {
    const [id, model, width, height, ...rest] = line.split(/\s+/);
    if (line === "" || id.startsWith("#")) continue;
    const at = pinholes[model];
    const numbers = rest.map(Number);
    if (!at) {
      ignored += 1;
      continue;
    }
    const [fx, fy, cx, cy] = at.map((i) => numbers[i]);
    cameras.set(id, { fx, fy, cx, cy, width: Number(width), height: Number(height) });
    if (numbers.slice(Math.max(...at) + 1).some((k) => Math.abs(k) > 1e-6)) ignored += 1;
  }
  return { cameras, ignored };
}

/** One row-major camera-to-world matrix, as 7-Scenes has beside each picture. */
export function parseMatrix(text) {
  const numbers = text.trim().split(/[\s,]+/).map(Number);
  const pose = { cameraFromWorld: invertRigid(numbers) };
  return numbers.length === 16 && usable(pose) ? pose : undefined;
}

/** The list of this page's own sample: `{ camera, pictures: [{ name, cam_from_world }] }`. */
export function parseSample(text) {
  const poses = new Map();
  let list;
  try {
    list = JSON.parse(text);
  } catch {
    return poses;
  }
  for (const { name, cam_from_world, camera } of Array.isArray(list?.pictures) ? list.pictures : []) {
    const pose = { cameraFromWorld: Float64Array.from((cam_from_world ?? []).flat()), intrinsics: camera ?? list.camera };
    if (pose.cameraFromWorld.length === 16 && usable(pose)) poses.set(name, pose);
  }
  return poses;
}

/**
 * What is known about the pictures among these files. `find` gives the pose of a picture's name; `source` says in words
 * where the poses are from; `notes` are sentences about what could not be read.
 */
export async function readPoses(files) {
  const notes = [];
  const named = (name) => files.find((file) => file.name === name);
  const left = (skipped, name) => skipped > 0 && notes.push(`${skipped} lines of ${name} could not be read.`);
  const answer = (poses, source) => ({ find: (name) => poses.get(name), source, notes });

  const single = files.filter((file) => /\.pose\.txt$/i.test(file.name));
  if (single.length > 0) {
    const poses = new Map();
    for (const file of single) {
      const pose = parseMatrix(await file.text());
      if (pose) poses.set(stem(file.name), pose);
    }
    if (poses.size < single.length) notes.push(`${single.length - poses.size} of the .pose.txt files could not be read.`);
    return { find: (name) => poses.get(stem(name)), source: "a .pose.txt of their own", notes };
  }
  const list = files.filter((file) => /pose[^/]*\.txt$|\.poses$/i.test(file.name)).sort((a, b) => a.name.localeCompare(b.name, "en"));
  if (list.length > 0) {
    const { poses, skipped } = parseList(await list[0].text());
    left(skipped, list[0].name);
    if (list.length > 1) notes.push(`Of ${list.length} lists of poses the first was read.`);
    return answer(poses, list[0].name);
  }
  const images = named("images.txt");
  if (images) {
    const { cameras, ignored } = named("cameras.txt") ? parseCameras(await named("cameras.txt").text()) : { cameras: new Map(), ignored: 0 };
    if (ignored > 0) notes.push(`The lens distortion of ${ignored} cameras is not taken into account.`);
    const { poses, skipped } = parseColmap(await images.text(), cameras);
    left(skipped, images.name);
    return answer(poses, "COLMAP’s images.txt");
  }
  for (const file of files.filter(({ name }) => name.endsWith(".json"))) {
    const poses = parseSample(await file.text());
    if (poses.size > 0) return answer(poses, file.name);
  }
  return answer(new Map(), "");
}
