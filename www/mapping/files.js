/** The origin's private file system: files on this device that only this page sees, written whole or not at all. */

/** True where this browser keeps files for pages and can write them whole. */
export const canKeep = () => typeof navigator.storage?.getDirectory === "function" && typeof globalThis.FileSystemFileHandle?.prototype.createWritable === "function";

export const cannotKeepWords = "This browser keeps no files for pages (a private window, or an older browser), so save the place as a file.";

/** A folder of this page, made where it is missing. */
export async function folder(name) {
  if (!canKeep()) throw Object.assign(new Error("this browser keeps no files for pages"), { code: "unsupported", hint: "Save the place as a file instead." });
  const root = await navigator.storage.getDirectory();
  return root.getDirectoryHandle(name, { create: true });
}

/** Removes a folder with everything in it. */
export async function removeFolder(name) {
  if (!canKeep()) return;
  const root = await navigator.storage.getDirectory();
  await root.removeEntry(name, { recursive: true }).catch(unlessMissing);
}

function unlessMissing(error) {
  if (error.name !== "NotFoundError") throw error;
}

async function exists(directory, name) {
  return directory.getFileHandle(name).then(
    () => true,
    () => false,
  );
}

/**
 * Writes a file. The browser writes beside it and puts the new content in place at the end; what cannot be finished leaves
 * what was there before, or nothing.
 */
export async function write(directory, name, content) {
  const isNew = !(await exists(directory, name));
  let stream;
  try {
    const file = await directory.getFileHandle(name, { create: true });
    stream = await file.createWritable();
    await stream.write(content);
    await stream.close();
  } catch (error) {
    await stream?.abort().catch(() => undefined);
    if (isNew) await directory.removeEntry(name).catch(() => undefined);
    if (error.name !== "QuotaExceededError") throw error;
    throw Object.assign(new Error("there is no storage left for this page"), { code: "storage-full", hint: "Delete places that you no longer need, or free space on this device. The place can still be saved as a file.", cause: error });
  }
}

export async function read(directory, name) {
  const handle = await directory.getFileHandle(name);
  return handle.getFile();
}

export const remove = (directory, name) => directory.removeEntry(name).catch(unlessMissing);

/** Names of the files of a folder, in order. */
export async function names(directory) {
  const found = [];
  for await (const [name, handle] of directory.entries()) if (handle.kind === "file") found.push(name);
  return found.sort();
}
