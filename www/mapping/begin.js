/** The first step: what to do, where the pictures come from, what an earlier visit left, and my places. */
import { button, el, heading } from "./elements.js";
import { placesList } from "./places_list.js";
import { plural } from "./words.js";

export async function beginStep(flow, left) {
  const picker = (kind, accept, multiple) => {
    const input = el("input", { type: "file", id: `map-${kind}`, accept, multiple, hidden: true, onchange: () => input.files.length > 0 && void flow.toFilm(kind, [...input.files]) });
    return input;
  };
  const video = picker("video", "video/*", false);
  const pictures = picker("pictures", "image/*", true);
  const list = await placesList(flow);
  flow.show("begin", [
    heading("Map this place"),
    el(
      "ol",
      { class: "map-how" },
      el("li", {}, el("strong", {}, "Walk round it slowly"), ", for one or two minutes, stepping sideways. Turning on the spot shows no depth."),
      el("li", {}, el("strong", {}, "Keep things in view"), " that have edges and patterns, with light on. Come back to where you began."),
      el("li", {}, el("strong", {}, "Wait a little."), " This device makes the map; pictures and map stay on it."),
    ),
    left ? unfinished(flow, left) : undefined,
    left ? el("p", { class: "fine" }, "Or begin anew: the film above makes room for another one then.") : undefined,
    el(
      "div",
      { class: "map-ways" },
      button("Film with the camera", () => flow.toFilm("camera"), { kind: left ? "button" : "button button-main", id: "map-camera" }),
      button("Use a video file", () => video.click(), { id: "map-from-video" }),
      button("Use pictures", () => pictures.click(), { id: "map-from-pictures" }),
      video,
      pictures,
    ),
    list,
  ].filter(Boolean));
}

/** The film that was not made into a map. */
function unfinished(flow, film) {
  const at = new Date(film.started);
  const when = Number.isNaN(at.valueOf()) ? "" : ` of ${at.toLocaleString("en-GB", { day: "numeric", month: "long", hour: "2-digit", minute: "2-digit" })}`;
  const go = (next) => {
    flow.takeUp(film);
    return next();
  };
  return el(
    "section",
    { class: "map-card", id: "map-unfinished", "aria-labelledby": "map-unfinished-title" },
    el("h3", { id: "map-unfinished-title" }, "A film waits to be made into a map"),
    el("p", {}, `${plural(film.pictures.length, "picture")}${when}, kept on this device.`),
    el(
      "div",
      { class: "row" },
      button("Make the map", () => go(() => flow.toBuild()), { kind: "button button-main", id: "map-go-on" }),
      button("Film more", () => go(() => flow.toFilm("camera", undefined, { more: true })), { id: "map-film-more" }),
      button("Throw it away", () => go(async () => {
        await flow.discardFilm();
        await flow.toBegin();
      }), { id: "map-throw" }),
    ),
  );
}
