/**
 * Bytes from URLs, files, buffers and streams: with progress, cancelling, limits, a cache and checksums.
 *
 * What was downloaded is kept only when its reader says that it is right. Entries carry the SHA-256 of what was stored
 * and what the server said of its version: one that no longer matches the first is thrown away, and the server is asked
 * about the second. So a damaged cache or a wrong answer costs a download, and a scene that was taught anew arrives.
 */
import { LandlineError } from "./errors.js";
import { isNode } from "./support.js";
import type { BytesSource, LoadedFile, ProgressEvent } from "./types.js";

const cacheName = "landline-v1";
const checksumHeader = "x-landline-sha256";
/** What servers say of a version of a file. All can be read of other origins only where these allow it. */
const versionHeaders = ["etag", "last-modified"] as const;
/** A server that takes longer to say whether a kept file is still right is not waited for. */
const askTimeoutMs = 4000;
/** A download of which nothing arrives for so long is given up, when the caller does not say. */
export const usualStallMs = 30_000;
/** The most bytes of a file, announced or not; that of scenes and weights is the format's own limit. */
export const maxBytes: Readonly<Record<LoadedFile, number>> = { engine: 1 << 26, extractor: 1 << 29, scene: 1 << 29, place: 1 << 24, index: 1 << 24 };
/** No announcement is believed beyond this: buffers grow as bytes arrive. */
const maxAnnounced = 1 << 24;
/** Steps of progress smaller than this are not worth an event. */
const progressStep = 64 * 1024;

export interface LoadOptions {
  file: LoadedFile;
  onProgress?: ((event: ProgressEvent) => void) | undefined;
  signal?: AbortSignal | undefined;
  cache?: "default" | "none" | undefined;
  integrity?: string | undefined;
  fetch?: typeof fetch | undefined;
  stallTimeoutMs?: number | undefined;
}

/** A file, and what its reader says of it. */
export interface Loaded {
  bytes: Uint8Array;
  /** Kept from an earlier visit: when it proves to be wrong, a new copy may be right. */
  fromCache: boolean;
  /** It is what it should be: keeps it for the next visit. */
  keep(): Promise<void>;
  /** It is not: forgets it. */
  drop(): Promise<void>;
}

/** Keeps nothing. */
function unkept(bytes: Uint8Array): Loaded {
  const nothing = async (): Promise<void> => undefined;
  return { bytes, fromCache: false, keep: nothing, drop: nothing };
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

/** A promise that is given up after a while; `problem` makes the words for it. */
async function within<T>(work: Promise<T>, timeoutMs: number, problem: () => LandlineError): Promise<T> {
  let timer: ReturnType<typeof setTimeout> | undefined;
  try {
    return await Promise.race([
      work,
      new Promise<never>((_, fail) => {
        timer = setTimeout(() => fail(problem()), timeoutMs);
      }),
    ]);
  } finally {
    clearTimeout(timer);
  }
}

function tooLarge(file: LoadedFile, from: string, announced: number): LandlineError {
  return new LandlineError("asset-fetch", `the ${file}${from} is larger than ${maxBytes[file] / 2 ** 20} MiB${announced > 0 ? `: ${announced} bytes are announced` : ""}`, "Check the address: no such file is that large.");
}

/** Collects a stream into one buffer that grows with what arrives. */
async function collect(stream: ReadableStream<Uint8Array>, announced: number, from: string, onBytes: (loaded: number) => void, options: LoadOptions): Promise<Uint8Array> {
  const { file, signal, stallTimeoutMs = usualStallMs } = options;
  const limit = maxBytes[file];
  if (announced > limit) {
    await stream.cancel().catch(() => undefined);
    throw tooLarge(file, from, announced);
  }
  const reader = stream.getReader();
  const abort = (): void => void reader.cancel(signal?.reason).catch(() => undefined);
  signal?.addEventListener("abort", abort, { once: true });
  const stalled = (): LandlineError => new LandlineError("asset-fetch", `the ${file}${from} stopped arriving after ${length} bytes: nothing came for ${stallTimeoutMs / 1000} s`, "Check the connection, then try again.");
  let bytes = new Uint8Array(announced > 0 ? Math.min(announced, maxAnnounced) : 1 << 20);
  let length = 0;
  try {
    for (;;) {
      const { done, value } = await within(reader.read(), stallTimeoutMs, stalled);
      signal?.throwIfAborted();
      if (done) break;
      if (length + value.length > limit) throw tooLarge(file, from, 0);
      if (length + value.length > bytes.length) {
        const larger = new Uint8Array(Math.max(Math.min(2 * bytes.length, limit), length + value.length));
        larger.set(bytes.subarray(0, length));
        bytes = larger;
      }
      bytes.set(value, length);
      length += value.length;
      onBytes(length);
    }
  } catch (error) {
    void reader.cancel().catch(() => undefined);
    throw error;
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

interface Kept {
  bytes: Uint8Array;
  headers: Headers;
}

async function fromCache(cache: Cache, url: string, options: LoadOptions): Promise<Kept | null> {
  try {
    const hit = await cache.match(url);
    if (!hit) return null;
    const stored = hit.headers.get(checksumHeader);
    const bytes = new Uint8Array(await hit.arrayBuffer());
    const actual = await sha256(bytes);
    const wanted = options.integrity === undefined ? stored : checksumAsHex(options.integrity);
    if (stored !== null && actual === stored && actual === wanted) return { bytes, headers: hit.headers };
    await cache.delete(url);
  } catch (error) {
    if (error instanceof LandlineError) throw error;
  }
  return null;
}

/** Bytes that go into the cache as soon as their reader is content with them. The copy is made at once: the reader may take the buffer. */
async function keepable(cache: Cache | null, url: string, bytes: Uint8Array, answer: Headers): Promise<Loaded> {
  const checksum = cache ? await sha256(bytes) : null;
  if (!cache || checksum === null) return unkept(bytes);
  const headers = new Headers({ "content-type": "application/octet-stream", "content-length": String(bytes.length), [checksumHeader]: checksum });
  for (const name of versionHeaders) {
    const version = answer.get(name);
    if (version !== null) headers.set(name, version);
  }
  const copy = new Response(bytes as Uint8Array<ArrayBuffer>, { headers });
  return {
    bytes,
    fromCache: false,
    // No room: the next visit downloads again.
    keep: () => cache.put(url, copy).catch(() => undefined),
    drop: async () => undefined,
  };
}

/** True when the answer is of the version that was kept. A server that says nothing of versions may have another one. */
function isSameVersion(kept: Headers, answer: Headers): boolean {
  for (const name of versionHeaders) {
    const version = answer.get(name);
    if (version !== null) return version === kept.get(name);
  }
  return false;
}

function baseUrl(): string | undefined {
  return (globalThis as { location?: { href?: string } }).location?.href;
}

async function request(url: string, options: LoadOptions, fresh: boolean): Promise<Response> {
  const { file, signal, stallTimeoutMs = usualStallMs } = options;
  const timeoutMs = fresh ? Math.min(askTimeoutMs, stallTimeoutMs) : stallTimeoutMs;
  const stop = new AbortController();
  const forward = (): void => stop.abort(signal?.reason);
  signal?.addEventListener("abort", forward, { once: true });
  const silent = (): LandlineError => new LandlineError("asset-fetch", `the ${file} could not be loaded from ${url}: the server did not answer for ${timeoutMs / 1000} s`, "Check the connection, then try again.");
  try {
    const asked = (options.fetch ?? globalThis.fetch)(url, { signal: stop.signal, ...(fresh ? { cache: "no-cache" as const } : {}) });
    return await within(asked, timeoutMs, silent);
  } catch (error) {
    stop.abort();
    signal?.throwIfAborted();
    if (error instanceof LandlineError) throw error;
    throw new LandlineError("asset-fetch", `the ${file} could not be loaded from ${url}: ${String((error as Error).message ?? error)}`, "Check the connection and the address, then try again.", error);
  } finally {
    signal?.removeEventListener("abort", forward);
  }
}

/** The body of an answer, whole and of the right kind. */
async function receive(response: Response, url: string, options: LoadOptions): Promise<Uint8Array> {
  const { file, signal } = options;
  if (!response.ok || response.body === null) {
    throw new LandlineError("asset-fetch", `the ${file} could not be loaded: ${url} answered ${response.status} ${response.statusText}`.trimEnd(), "Check the address.");
  }
  // With compression the header counts other bytes than the stream delivers.
  const total = response.headers.get("content-encoding") ? 0 : Number(response.headers.get("content-length") ?? 0) || 0;
  const report = (loaded: number): void => options.onProgress?.({ status: "download", file, url, loaded, total, fromCache: false });
  report(0);
  let reported = 0;
  const onBytes = (loaded: number): void => {
    if (loaded - reported < progressStep && loaded !== total) return;
    reported = loaded;
    report(loaded);
  };
  let bytes: Uint8Array;
  try {
    bytes = await collect(response.body, total, ` from ${url}`, onBytes, options);
  } catch (error) {
    signal?.throwIfAborted();
    if (error instanceof LandlineError) throw error;
    throw new LandlineError("asset-fetch", `the connection broke while the ${file} was loading from ${url}: ${String((error as Error).message ?? error)}`, "Check the connection, then try again.", error);
  }
  if (total > 0 && bytes.length < total) {
    throw new LandlineError("asset-fetch", `the ${file} from ${url} ended after ${bytes.length} of ${total} bytes`, "Check the connection, then try again.");
  }
  if (looksLikeWebPage(bytes)) {
    throw new LandlineError("asset-fetch", `${url} is a web page (content type ${response.headers.get("content-type") ?? "unknown"}), not the ${file}`, "Check the address: many servers answer with their start page when a file is missing.");
  }
  await checkIntegrity(bytes, options, url);
  return bytes;
}

async function download(url: string, options: LoadOptions): Promise<Loaded> {
  const { file, signal, onProgress } = options;
  const cache = await openCache(options);
  const kept = cache ? await fromCache(cache, url, options) : null;
  signal?.throwIfAborted();
  const useKept = (cache: Cache, { bytes }: Kept, isChecked: boolean): Loaded => {
    onProgress?.({ status: "download", file, url, loaded: bytes.length, total: bytes.length, fromCache: true });
    onProgress?.({ status: "done", file, bytes: bytes.length, fromCache: true, ...(isChecked ? {} : { unchecked: true }) });
    return { bytes, fromCache: true, keep: async () => undefined, drop: async () => void (await cache.delete(url).catch(() => false)) };
  };
  // The checksum that the caller asked for says all that a server could.
  if (cache && kept && options.integrity !== undefined) return useKept(cache, kept, true);
  try {
    const response = await request(url, options, kept !== null);
    if (cache && kept && response.ok && isSameVersion(kept.headers, response.headers)) {
      await response.body?.cancel().catch(() => undefined);
      return useKept(cache, kept, true);
    }
    const bytes = await receive(response, url, options);
    onProgress?.({ status: "done", file, bytes: bytes.length, fromCache: false });
    return await keepable(cache, url, bytes, response.headers);
  } catch (error) {
    signal?.throwIfAborted();
    // Without a network, or with a server that is out of order, what was right the last time serves.
    if (cache && kept && error instanceof LandlineError && error.code === "asset-fetch") return useKept(cache, kept, false);
    throw error;
  }
}

/** Loads bytes from whatever the caller has. The answer is never a view into the caller's own buffer. */
export async function load(source: BytesSource, options: LoadOptions): Promise<Loaded> {
  const { file, signal } = options;
  signal?.throwIfAborted();
  const finish = async (bytes: Uint8Array): Promise<Loaded> => {
    if (bytes.length > maxBytes[file]) throw tooLarge(file, "", bytes.length);
    await checkIntegrity(bytes, options, "the given bytes");
    options.onProgress?.({ status: "done", file, bytes: bytes.length, fromCache: false });
    return unkept(bytes);
  };
  if (source instanceof ArrayBuffer) return finish(new Uint8Array(source.slice(0)));
  if (source instanceof Uint8Array) return finish(Uint8Array.from(source));
  if (typeof Blob !== "undefined" && source instanceof Blob) {
    if (source.size > maxBytes[file]) throw tooLarge(file, "", source.size);
    return finish(new Uint8Array(await source.arrayBuffer()));
  }
  if (typeof ReadableStream !== "undefined" && source instanceof ReadableStream) {
    const report = (loaded: number): void => options.onProgress?.({ status: "download", file, url: "", loaded, total: 0, fromCache: false });
    return finish(await collect(source, 0, "", report, options));
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
