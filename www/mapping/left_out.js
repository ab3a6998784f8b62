/** Pictures that were left out, and why: each reason once, with its pictures on demand. */
import { el } from "./elements.js";
import { plural } from "./words.js";

/** `rows` are a name and a reason each; nothing where there are none. */
export function leftOutList(rows, open = false) {
  if (rows.length === 0) return undefined;
  const reasons = new Map();
  for (const [name, reason] of rows) reasons.set(reason, [...(reasons.get(reason) ?? []), name]);
  const commonestFirst = [...reasons].sort(([, a], [, b]) => b.length - a.length);
  const items = commonestFirst.map(([reason, names]) =>
    el("li", {}, el("details", { class: "map-reason" }, el("summary", {}, `${plural(names.length, "picture")}: ${reason}`), el("p", { class: "fine" }, names.join(", ")))),
  );
  return el("details", { class: "map-card", id: "map-problems", open }, el("summary", {}, `${plural(rows.length, "picture")} left out, and why`), el("ul", {}, ...items));
}
