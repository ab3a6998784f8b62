/** Poses that lie with pictures, by the readers of the native tool. */
import { loadEngine } from "../init.js";
import { isNode } from "../support.js";
import { checkPoses } from "./arguments.js";
import { directChannel, workerChannel } from "./channel.js";
import { packagedMapperWasmUrl } from "./mapper.js";
import type { KnownPoses, PoseFile, ReadPosesOptions } from "./types.js";

/**
 * Poses of pictures out of files that data sets come with: a COLMAP model (`images.txt` or `.bin`, with its cameras), a
 * matrix `NAME.pose.txt` beside each picture, or a list of poses. Pictures are given by their paths; what is no text and no model
 * is passed over, and a damaged file gives no pose and a note that names the place.
 *
 * Rejects as `Mapper.create` does where the engine cannot be loaded.
 */
export async function readPoses(pictures: readonly string[], files: readonly PoseFile[], options: ReadPosesOptions = {}): Promise<KnownPoses> {
  checkPoses(pictures, files, options);
  const { signal, onProgress, fetch, stallTimeoutMs, worker = !isNode(), workerUrl, wasm = packagedMapperWasmUrl() } = options;
  signal?.throwIfAborted();
  const { module } = await loadEngine({ wasm, onProgress, fetch, stallTimeoutMs, signal });
  const nothing = (): void => undefined;
  const channel = worker ? workerChannel(workerUrl, nothing) : directChannel(nothing);
  const abort = (): void => channel.close();
  signal?.addEventListener("abort", abort, { once: true });
  try {
    return await channel.call("poses", { module, pictures, files });
  } catch (error) {
    signal?.throwIfAborted();
    throw error;
  } finally {
    signal?.removeEventListener("abort", abort);
    channel.close();
  }
}
