/**
 * Bytes from URLs, files, buffers and streams: with progress, cancelling, a cache and checksums.
 *
 * Cached entries carry the SHA-256 of what was stored. An entry that no longer matches it is thrown away and loaded
 * again, so that a damaged cache costs one download and nothing else.
 */
import { LandlineError } from "./errors.js";
import { isNode } from "./support.js";
import type { BytesSource, LoadedFile, ProgressEvent } from "./types.js";

const cacheName = "landline-v1";
const checksumHeader = "x-landline-sha256";
/** Steps of progress smaller than this are not worth an event. */
const progressStep = 64 * 1024;

export interface LoadOptions {
  file: LoadedFile;
  onProgress?: ((event: ProgressEvent) => void) | undefined;
  signal?: AbortSignal | undefined;
  cache?: "default" | "none" | undefined;
  integrity?: string | undefined;
  fetch?: typeof fetch | undefined;
}

/** The parts of Node that are used; `process.getBuiltinModule` keeps bundlers from seeing an import. */
interface NodeFs {
  readFile(path: string | URL, options?: { signal?: AbortSignal | undefined }): Promise<Uint8Array>;
}

function nodeFs(): NodeFs {
  const process = (globalThis as unknown as { process: { getBuiltinModule?: (id: string) => { promises: NodeFs } | undefined } }).process;
  const fs = process.getBuiltinModule?.("node:fs");
  if (!fs) throw new LandlineError("unsupported", "files can be read from Node 20.16 on", "Pass bytes instead of a path, or update Node.");
  return fs.promises;
}

function hex(bytes: ArrayBuffer): string {
  return Array.from(new Uint8Array(bytes), (b) => b.toString(16).padStart(2, "0")).join("");
}

/** SHA-256 as 64 hex digits; `null` where the browser gives no access to it (pages without HTTPS). */
export async function sha256(bytes: Uint8Array): Promise<string | null> {
  const subtle = globalThis.crypto?.subtle;
  if (!subtle) return null;
  return hex(await subtle.digest("SHA-256", bytes as Uint8Array<ArrayBuffer>));
}

/** Accepts 64 hex digits or the `sha256-<base64>` form of subresource integrity. */
export function checksumAsHex(integrity: string): string {
  if (/^[0-9a-fA-F]{64}$/.test(integrity)) return integrity.toLowerCase();
  const base64 = /^sha256-([A-Za-z0-9+/]{43}=)$/.exec(integrity)?.[1];
  if (base64 === undefined) {
    throw new LandlineError("bad-input", `integrity ${JSON.stringify(integrity)} is neither 64 hex digits nor sha256-<base64>`);
  }
  return Array.from(atob(base64), (c) => c.charCodeAt(0).toString(16).padStart(2, "0")).join("");
}

async function checkIntegrity(bytes: Uint8Array, options: LoadOptions, from: string): Promise<void> {
  if (options.integrity === undefined) return;
  const expected = checksumAsHex(options.integrity);
  const actual = await sha256(bytes);
  if (actual === null) {
    throw new LandlineError("unsupported", `the ${options.file} cannot be checked: this page has no access to SHA-256`, "Serve the page over HTTPS.");
  }
  if (actual !== expected) {
    throw new LandlineError(
      "asset-integrity",
      `the ${options.file} from ${from} has SHA-256 ${actual}, expected ${expected}`,
      "The file was changed or damaged on its way; load it again or correct the expected checksum.",
    );
  }
}

/** Collects a stream into one buffer; grows only when the announced length was wrong or missing. */
async function collect(
  stream: ReadableStream<Uint8Array>,
  announced: number,
  onBytes: (loaded: number) => void,
  signal: AbortSignal | undefined,
): Promise<Uint8Array> {
  const reader = stream.getReader();
  const abort = (): void => void reader.cancel(signal?.reason).catch(() => undefined);
  signal?.addEventListener("abort", abort, { once: true });
  let bytes = new Uint8Array(announced > 0 ? announced : 1 << 20);
  let length = 0;
  try {
    for (;;) {
      const { done, value } = await reader.read();
      signal?.throwIfAborted();
      if (done) break;
      if (length + value.length > bytes.length) {
        const larger = new Uint8Array(Math.max(2 * bytes.length, length + value.length));
        larger.set(bytes.subarray(0, length));
        bytes = larger;
      }
      bytes.set(value, length);
      length += value.length;
      onBytes(length);
    }
  } finally {
    signal?.removeEventListener("abort", abort);
    reader.releaseLock();
  }
  return length === bytes.length ? bytes : bytes.slice(0, length);
}

function looksLikeWebPage(bytes: Uint8Array): boolean {
  const head = new TextDecoder("utf-8", { fatal: false }).decode(bytes.subarray(0, 64)).trimStart().toLowerCase();
  return head.startsWith("<!doctype") || head.startsWith("<html");
}

async function openCache(options: LoadOptions): Promise<Cache | null> {
  if (options.cache === "none" || typeof caches === "undefined") return null;
  try {
    return await caches.open(cacheName);
  } catch {
    // Private windows and full disks refuse; loading works all the same.
    return null;
  }
}

async function fromCache(cache: Cache, url: string, options: LoadOptions): Promise<Uint8Array | null> {
  try {
    const hit = await cache.match(url);
    if (!hit) return null;
    const stored = hit.headers.get(checksumHeader);
    const bytes = new Uint8Array(await hit.arrayBuffer());
    const actual = await sha256(bytes);
    const wanted = options.integrity === undefined ? stored : checksumAsHex(options.integrity);
    if (stored !== null && actual === stored && actual === wanted) return bytes;
    await cache.delete(url);
  } catch (error) {
    if (error instanceof LandlineError) throw error;
  }
  return null;
}

async function intoCache(cache: Cache, url: string, bytes: Uint8Array): Promise<void> {
  const checksum = await sha256(bytes);
  if (checksum === null) return;
  try {
    await cache.put(
      url,
      new Response(bytes as Uint8Array<ArrayBuffer>, {
        headers: { "content-type": "application/octet-stream", "content-length": String(bytes.length), [checksumHeader]: checksum },
      }),
    );
  } catch {
    // No room: the next visit downloads again.
  }
}

function baseUrl(): string | undefined {
  return (globalThis as { location?: { href?: string } }).location?.href;
}

async function download(url: string, options: LoadOptions): Promise<Uint8Array> {
  const { file, signal } = options;
  const cache = await openCache(options);
  const report = (loaded: number, total: number, cached: boolean): void =>
    options.onProgress?.({ status: "download", file, url, loaded, total, fromCache: cached });
  if (cache) {
    const hit = await fromCache(cache, url, options);
    signal?.throwIfAborted();
    if (hit) {
      report(hit.length, hit.length, true);
      options.onProgress?.({ status: "done", file, bytes: hit.length, fromCache: true });
      return hit;
    }
  }
  let response: Response;
  let bytes: Uint8Array;
  let total = 0;
  try {
    response = await (options.fetch ?? globalThis.fetch)(url, signal ? { signal } : {});
  } catch (error) {
    signal?.throwIfAborted();
    throw new LandlineError("asset-fetch", `the ${file} could not be loaded from ${url}: ${String((error as Error).message ?? error)}`, "Check the connection and the address, then try again.", error);
  }
  if (!response.ok || response.body === null) {
    throw new LandlineError("asset-fetch", `the ${file} could not be loaded: ${url} answered ${response.status} ${response.statusText}`.trimEnd(), "Check the address.");
  }
  // With compression the header counts other bytes than the stream delivers.
  if (!response.headers.get("content-encoding")) total = Number(response.headers.get("content-length") ?? 0) || 0;
  report(0, total, false);
  let reported = 0;
  try {
    bytes = await collect(
      response.body,
      total,
      (loaded) => {
        if (loaded - reported >= progressStep || loaded === total) {
          reported = loaded;
          report(loaded, total, false);
        }
      },
      signal,
    );
  } catch (error) {
    signal?.throwIfAborted();
    throw new LandlineError("asset-fetch", `the connection broke while the ${file} was loading from ${url}: ${String((error as Error).message ?? error)}`, "Check the connection, then try again.", error);
  }
  if (total > 0 && bytes.length < total) {
    throw new LandlineError("asset-fetch", `the ${file} from ${url} ended after ${bytes.length} of ${total} bytes`, "Check the connection, then try again.");
  }
  if (looksLikeWebPage(bytes)) {
    throw new LandlineError("asset-fetch", `${url} is a web page (content type ${response.headers.get("content-type") ?? "unknown"}), not the ${file}`, "Check the address: many servers answer with their start page when a file is missing.");
  }
  await checkIntegrity(bytes, options, url);
  if (cache) await intoCache(cache, url, bytes);
  options.onProgress?.({ status: "done", file, bytes: bytes.length, fromCache: false });
  return bytes;
}

/** Loads bytes from whatever the caller has. The answer is never a view into the caller's own buffer. */
export async function loadBytes(source: BytesSource, options: LoadOptions): Promise<Uint8Array> {
  const { file, signal } = options;
  signal?.throwIfAborted();
  const finish = async (bytes: Uint8Array): Promise<Uint8Array> => {
    await checkIntegrity(bytes, options, "the given bytes");
    options.onProgress?.({ status: "done", file, bytes: bytes.length, fromCache: false });
    return bytes;
  };
  if (source instanceof ArrayBuffer) return finish(new Uint8Array(source.slice(0)));
  if (source instanceof Uint8Array) return finish(Uint8Array.from(source));
  if (typeof Blob !== "undefined" && source instanceof Blob) return finish(new Uint8Array(await source.arrayBuffer()));
  if (typeof ReadableStream !== "undefined" && source instanceof ReadableStream) {
    const report = (loaded: number): void => options.onProgress?.({ status: "download", file, url: "", loaded, total: 0, fromCache: false });
    return finish(await collect(source, 0, report, signal));
  }
  if (typeof source === "string" || source instanceof URL) {
    if (isNode() && !/^(https?|data|blob):/i.test(String(source))) {
      try {
        return await finish(await nodeFs().readFile(source instanceof URL || !source.startsWith("file:") ? source : new URL(source), { signal }).then((b) => Uint8Array.from(b)));
      } catch (error) {
        signal?.throwIfAborted();
        if (error instanceof LandlineError) throw error;
        throw new LandlineError("asset-fetch", `the ${file} could not be read from ${String(source)}: ${(error as Error).message}`, "Check the path.", error);
      }
    }
    let url: string;
    try {
      url = new URL(source, baseUrl()).href;
    } catch (error) {
      throw new LandlineError("bad-input", `${JSON.stringify(String(source))} is not an address for the ${file}`, "", error);
    }
    return download(url, options);
  }
  throw new LandlineError("bad-input", `the ${file} must be a URL, an ArrayBuffer, a Uint8Array, a Blob or a ReadableStream, not ${source === null ? "null" : typeof source}`);
}

/** True when the file at this address is in the cache. */
export async function isCached(url: string | URL): Promise<boolean> {
  if (typeof caches === "undefined") return false;
  return (await (await caches.open(cacheName)).match(new URL(url, baseUrl()).href)) !== undefined;
}

/** Removes everything that this package has stored on the device. */
export async function clearCache(): Promise<void> {
  if (typeof caches !== "undefined") await caches.delete(cacheName);
}
