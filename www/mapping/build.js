/** From the film to the place: progress by stage, how long it will take, and Cancel. */
import { feed } from "./feed.js";
import { button, el, heading } from "./elements.js";
import { loadingWords } from "./loading_words.js";
import { defaultName, duration, plural, stages, toGo } from "./words.js";

export async function buildStep(flow) {
  const cancel = new AbortController();
  const note = el("p", { id: "map-stage-note" }, "Beginning…");
  const eta = el("p", { class: "fine", id: "map-eta" });
  const progress = el("progress", { max: 1, value: 0, "aria-label": "How much of the map is made" });
  const rows = new Map(stages.map(([key, words]) => [key, el("li", { "data-state": "waits" }, words)]));
  const count = flow.film?.pictures.length ?? 0;
  let left = false;
  flow.show(
    "build",
    [
      heading("Making the map"),
      el("p", {}, `Of ${plural(count, "picture")}. Keep this page in front; it works on this device alone.`),
      note,
      progress,
      eta,
      el("ol", { class: "map-stages" }, ...rows.values()),
      el("div", { class: "map-ways" }, button("Cancel", () => cancel.abort(), { id: "map-cancel" })),
    ],
    () => {
      left = true;
      cancel.abort();
      void wake.then((lock) => lock?.release());
    },
  );
  const wake = navigator.wakeLock?.request("screen").catch(() => undefined) ?? Promise.resolve();
  const started = performance.now();
  let current;
  const onProgress = ({ stage, share, etaSeconds }) => {
    if (stage !== current) {
      current = stage;
      let passed = true;
      for (const [key, row] of rows) {
        if (key === stage) passed = false;
        row.dataset.state = key === stage ? "now" : passed ? "done" : "waits";
        if (key === stage) row.setAttribute("aria-current", "step");
        else row.removeAttribute("aria-current");
      }
      const words = rows.get(stage)?.textContent ?? stage;
      note.textContent = words;
      flow.announcer.say(words);
    }
    progress.max = 1;
    progress.value = share;
    eta.textContent = etaSeconds === undefined ? `${duration((performance.now() - started) / 1000)} so far` : toGo(etaSeconds);
  };
  try {
    const mapper = await feed(flow, (event) => {
      note.textContent = loadingWords(event);
      if (event.status === "again") [progress.max, progress.value] = [event.total, event.done];
    }, cancel.signal);
    cancel.signal.throwIfAborted();
    const name = defaultName();
    const { scene, report } = await mapper.build({ signal: cancel.signal, onProgress, name });
    if (!left) await flow.toResult({ scene, report, name });
  } catch (error) {
    if (left) return;
    if (cancel.signal.aborted) flow.toHeld({ title: "Cancelled", text: "No map was made.", hint: "" });
    else await flow.toFailure(error);
  }
}
