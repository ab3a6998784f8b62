/**
 * Keeps the page for offline use. Its files come from the network while there is one, so that an update shows at the
 * next visit; without a network they come from the cache. Weights and scenes are not kept here: the package itself keeps
 * them in a cache of its own that it checks.
 */
const cacheName = "landline-page-v1";
/**
 * What the engine's worker may do; it is not reached by the policy of the page. Nothing but the scripts beside it, so that
 * `import()` leads nowhere else. Static hosts that send no headers get it from here, from the second visit on.
 */
const workerPolicy = "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'";
/** What maps, and what is for places of many rooms, is kept from its first use on: who locates in one scene need not load it. */
const isForLater = (path) => /(^|\/)(mapping|mapper|place)\//.test(path);
// The probe of the package's `support.js`: the engine has two builds, and only the one that runs here is kept.
const relaxedProbe = [0, 97, 115, 109, 1, 0, 0, 0, 1, 4, 1, 96, 0, 0, 3, 2, 1, 0, 10, 20, 1, 18, 0, 65, 0, 253, 17, 65, 0, 253, 17, 65, 0, 253, 17, 253, 133, 2, 26, 11];
const otherBuild = WebAssembly.validate(new Uint8Array(relaxedProbe)) ? "landline_bg.wasm" : "landline_relaxed_bg.wasm";
const isOtherBuild = (path) => path.endsWith(`/${otherBuild}`);
const isWeights = (path) => /\.(landline|safetensors|tgz|place\.json|place\.index)$/.test(path);

self.addEventListener("install", (event) => {
  event.waitUntil(keepPage().then(() => self.skipWaiting()));
});

self.addEventListener("activate", (event) => {
  event.waitUntil(
    (async () => {
      for (const name of await caches.keys()) if (name.startsWith("landline-page-") && name !== cacheName) await caches.delete(name);
      await self.clients.claim();
    })(),
  );
});

/** `files.json` is written beside the page when it is built: every file with a hash of its content. */
async function keepPage() {
  const cache = await caches.open(cacheName);
  const response = await fetch("./files.json", { cache: "no-cache" });
  if (!response.ok) return;
  const files = Object.keys(await response.json()).filter((path) => !isWeights(path) && !isForLater(path) && !isOtherBuild(path) && /\.(html|js|css|svg|wasm|json|webmanifest|png|jpg|jpeg|webp)$/.test(path));
  await cache.addAll(["./", ...files.map((path) => `./${path}`)]);
}

self.addEventListener("fetch", (event) => {
  const { request } = event;
  const url = new URL(request.url);
  if (request.method !== "GET" || url.origin !== self.location.origin || isWeights(url.pathname)) return;
  event.respondWith(answer(request));
});

async function answer(request) {
  const cache = await caches.open(cacheName);
  try {
    const response = await fetch(request);
    if (response.ok && response.type === "basic") void cache.put(request, response.clone()).catch(() => {});
    return sealed(request, response);
  } catch (error) {
    const hit = (await cache.match(request, { ignoreSearch: request.mode === "navigate" })) ?? (request.mode === "navigate" ? await cache.match("./") : undefined);
    if (hit) return sealed(request, hit);
    throw error;
  }
}

function sealed(request, response) {
  if (request.destination !== "worker" || !response.ok) return response;
  const { body, status, statusText } = response;
  const headers = new Headers(response.headers);
  headers.set("content-security-policy", workerPolicy);
  return new Response(body, { status, statusText, headers });
}
