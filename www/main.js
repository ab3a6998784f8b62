/** The page's start. Counting what is sent comes before everything that could send. */
import { onChange } from "./privacy.js";
import { checkSupport } from "landline";
import { wire } from "./controls.js";
import { query } from "./dom.js";
import { showEmpty } from "./loading.js";
import { startFirst } from "./open.js";
import { showPrivacy, status } from "./panels.js";
import { map, state } from "./session.js";

async function registerOffline() {
  if (!("serviceWorker" in navigator) || query.has("no-offline")) return;
  try {
    await navigator.serviceWorker.register("./sw.js");
  } catch {
    // Without it the page needs the network at the next visit; nothing else changes.
  }
}

// For tests and for curious people at the console.
globalThis.landlinePage = { state, map };
wire();
onChange(showPrivacy);
void registerOffline();
const support = await checkSupport();
if (support.ok) {
  await startFirst();
} else {
  showEmpty("This browser cannot run Landline", support.reasons.join(" "));
  status("bad", "Not supported", support.reasons[0] ?? "");
}
