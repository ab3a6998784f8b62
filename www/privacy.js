/** Counts what this page sends, by standing in front of everything that can send. Load before anything else. */

const counts = { bytes: 0, requests: 0, afterReady: 0 };
let ready = false;
let changed = () => {};

function size(body) {
  if (body === null || body === undefined) return 0;
  if (typeof body === "string") return new TextEncoder().encode(body).length;
  if (body instanceof Blob) return body.size;
  if (body instanceof ArrayBuffer || ArrayBuffer.isView(body)) return body.byteLength;
  if (body instanceof URLSearchParams) return size(String(body));
  if (body instanceof FormData) return [...body.values()].reduce((sum, value) => sum + size(value), 0);
  return 1; // a stream: its length is unknown, but it is not nothing
}

/** Bytes of what follows the question mark: an address can carry anything, too. */
function sizeOfQuery(address) {
  try {
    return size(new URL(String(address?.url ?? address), location.href).search.slice(1));
  } catch {
    return 0; // no address: the call itself will say so
  }
}

function count(body, address) {
  const bytes = size(body) + sizeOfQuery(address);
  if (bytes === 0) return;
  counts.bytes += bytes;
  changed(counts);
}

const { fetch } = globalThis;
globalThis.fetch = (input, init) => {
  count(init?.body ?? (input instanceof Request ? input.body : null), input);
  return fetch(input, init);
};
const { open: openRequest, send } = XMLHttpRequest.prototype;
XMLHttpRequest.prototype.open = function (method, url, ...rest) {
  count(null, url);
  return openRequest.call(this, method, url, ...rest);
};
XMLHttpRequest.prototype.send = function (body) {
  count(body);
  return send.call(this, body);
};
const { sendBeacon } = navigator;
if (sendBeacon) {
  navigator.sendBeacon = (url, body) => {
    count(body, url);
    return sendBeacon.call(navigator, url, body);
  };
}
const socketSend = WebSocket.prototype.send;
WebSocket.prototype.send = function (body) {
  count(body);
  return socketSend.call(this, body);
};

/** Ways to send that the page has no use for and that cannot be counted: closed. */
for (const name of ["RTCPeerConnection", "webkitRTCPeerConnection", "EventSource", "WebTransport", "WebSocketStream"]) {
  if (name in globalThis) Object.defineProperty(globalThis, name, { value: undefined, writable: false, configurable: false });
}

/** Files that the page loads; pictures of the user are `blob:` and never leave memory. */
new PerformanceObserver((list) => {
  for (const { name } of list.getEntries()) {
    if (!/^https?:/.test(name)) continue;
    counts.requests += 1;
    if (ready) counts.afterReady += 1;
  }
  changed(counts);
}).observe({ type: "resource", buffered: true });

export function onChange(listener) {
  changed = listener;
  listener(counts);
}

/** From here on the page should need nothing more from its server. */
export function markReady() {
  ready = true;
}
