/** The film is there and the map is not: cancelled, failed, or the camera went away. */
import { button, el, heading } from "./elements.js";
import { leftOutList } from "./left_out.js";
import { plural } from "./words.js";

/** `{ title, text, hint }` say what happened; `films` when only more pictures help. */
export function heldStep(flow, { title, text, hint, films = false }) {
  const count = flow.film?.pictures.length ?? 0;
  const leftOut = flow.film?.leftOut ?? [];
  const make = count > 1 && ((kind) => button(films ? "Try again with these" : "Make the map", () => flow.toBuild(), { kind, id: "map-again" }));
  const more = (kind) => button(count > 0 ? "Film more" : "Film with the camera", () => flow.toFilm("camera", undefined, { more: count > 0 }), { kind, id: "map-film-more" });
  flow.show("held", [
    heading(title),
    el("p", { id: "map-held-text" }, text),
    hint ? el("p", { class: "problem-hint", id: "map-held-hint" }, hint) : undefined,
    el("p", { class: "fine" }, count === 0 ? "No pictures were kept." : `${plural(count, "picture")} kept${flow.film.unkept ? " until this page is closed" : " on this device"}.`),
    leftOutList(leftOut, count === 0),
    el(
      "div",
      { class: "map-ways" },
      ...(films || count < 2 ? [more, make] : [make, more]).filter(Boolean).map((next, i) => next(i === 0 ? "button button-main" : "button")),
      button(count > 0 ? "Throw the film away" : "Back", async () => {
        await flow.discardFilm();
        await flow.toBegin();
      }, { id: "map-throw" }),
    ),
  ].filter(Boolean));
}
