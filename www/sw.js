/**
 * Keeps the page for offline use. Its own files come from the network while there is one, so that an update shows at the
 * next visit; without a network they come from the cache. The weights are kept by the package itself.
 */
const cacheName = "landline-page-v1";

self.addEventListener("install", (event) => {
  event.waitUntil(self.skipWaiting());
});

self.addEventListener("activate", (event) => {
  event.waitUntil(
    (async () => {
      for (const name of await caches.keys()) if (name.startsWith("landline-page-") && name !== cacheName) await caches.delete(name);
      await self.clients.claim();
      // The visit that installs this worker has loaded its files before the worker could see them.
      const cache = await caches.open(cacheName);
      for (const client of await self.clients.matchAll({ type: "window" })) client.postMessage("landline-offline-ready");
      await cache.add(new Request("./index.html", { cache: "reload" })).catch(() => {});
    })(),
  );
});

/** Addresses that the page has loaded before this worker was there. */
self.addEventListener("message", (event) => {
  const { keep } = event.data ?? {};
  if (!Array.isArray(keep)) return;
  event.waitUntil(
    (async () => {
      const cache = await caches.open(cacheName);
      for (const url of keep) {
        if (new URL(url).origin === self.location.origin && !(await cache.match(url))) await cache.add(url).catch(() => {});
      }
    })(),
  );
});

self.addEventListener("fetch", (event) => {
  const { request } = event;
  const url = new URL(request.url);
  if (request.method !== "GET" || url.origin !== self.location.origin) return;
  // The package keeps weights in a checked cache of its own.
  if (/\.(landline|safetensors)$/.test(url.pathname)) return;
  event.respondWith(answer(request));
});

async function answer(request) {
  const cache = await caches.open(cacheName);
  try {
    const response = await fetch(request);
    if (response.ok && response.type === "basic") void cache.put(request, response.clone()).catch(() => {});
    return response;
  } catch (error) {
    const hit = (await cache.match(request, { ignoreSearch: request.mode === "navigate" })) ?? (request.mode === "navigate" ? await cache.match("./index.html") : undefined);
    if (hit) return hit;
    throw error;
  }
}
