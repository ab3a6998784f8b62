/**
 * My places: scenes that were mapped here, kept in the origin's private file system. A place is two files, `ID.landline`
 * and `ID.json`; the second is written last, and a place without it is none.
 */
import { canKeep, folder, names, read, remove, write } from "./files.js";

const where = "landline-places";
const open = () => folder(where);

/** `{ id, name, created, bytes, pictures, metric }` of each place, the newest first. Leftovers are removed. */
export async function listPlaces() {
  if (!canKeep()) return [];
  const directory = await open();
  const all = await names(directory);
  const places = [];
  for (const file of all) {
    const [id, ending] = [file.replace(/\.\w+$/, ""), file.split(".").pop()];
    const about = ending === "json" ? await describe(directory, id, all) : undefined;
    if (about) places.push(about);
    // A tab of the same page may be between the two files; what has no description an hour later was left behind.
    else if (ending === "landline" && !all.includes(`${id}.json`) && Date.now() - (await read(directory, file)).lastModified > 3_600_000) await remove(directory, file);
  }
  return places.sort((a, b) => b.created.localeCompare(a.created));
}

async function describe(directory, id, all) {
  if (!all.includes(`${id}.landline`)) return undefined;
  try {
    const about = JSON.parse(await (await read(directory, `${id}.json`)).text());
    const { size } = await read(directory, `${id}.landline`);
    if (typeof about.name !== "string" || typeof about.created !== "string" || size === 0) return undefined;
    return { ...about, id, bytes: size };
  } catch {
    // Written by something else; it is not shown and not touched.
    return undefined;
  }
}

/** Keeps a scene; `id` replaces the place that was kept under it. */
export async function keepPlace(scene, { name, pictures, metric }, id = crypto.randomUUID()) {
  const directory = await open();
  await write(directory, `${id}.landline`, scene);
  const about = { name, pictures, metric, created: new Date().toISOString() };
  try {
    await write(directory, `${id}.json`, JSON.stringify(about));
  } catch (error) {
    const known = await names(directory);
    if (!known.includes(`${id}.json`)) await remove(directory, `${id}.landline`);
    throw error;
  }
  // Without this the browser may remove the page's files when the device runs short; it may say no.
  await navigator.storage.persist?.().catch(() => false);
  return { ...about, id, bytes: scene.byteLength };
}

export async function renamePlace({ id, bytes: _, ...about }, name) {
  await write(await open(), `${id}.json`, JSON.stringify({ ...about, name }));
}

export async function deletePlace({ id }) {
  const directory = await open();
  await remove(directory, `${id}.json`);
  await remove(directory, `${id}.landline`);
}

export const sceneOf = async ({ id }) => read(await open(), `${id}.landline`);

/** A scene as a file with the place's name. */
export const placeFile = (scene, name) => new File([scene], fileName(name), { type: "application/octet-stream" });

/** A name that every file system takes. */
export function fileName(name) {
  const plain = name.normalize("NFC").replace(/[^\p{L}\p{N} ._-]+/gu, " ").replace(/\s+/g, "-").replace(/^[-.]+|[-.]+$/g, "").slice(0, 80);
  return `${plain || "place"}.landline`;
}

/** Bytes that this page may still keep; `undefined` where the browser does not say. */
export async function room() {
  const { quota, usage } = (await navigator.storage?.estimate?.().catch(() => undefined)) ?? {};
  return quota === undefined ? undefined : Math.max(0, quota - usage);
}
