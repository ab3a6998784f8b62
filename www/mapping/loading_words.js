/** What the mapper's loading looks like in one line. */
import { bytes } from "../panels.js";

const files = { engine: "the mapper", extractor: "the feature finder", scene: "the place" };

export function loadingWords(event) {
  if (event.status === "download" && event.total > 0) return `Loading ${files[event.file] ?? event.file}: ${bytes(event.loaded)} of ${bytes(event.total)}`;
  if (event.status === "again") return `Reading picture ${event.done} of ${event.total} again`;
  return "Loading the mapper…";
}
