/** The finished place: what it is, how it looks, what failed; name it, try it, save it. */
import { bytes } from "../panels.js";
import { save } from "../report.js";
import { button, el, heading } from "./elements.js";
import { canKeep, cannotKeepWords } from "./files.js";
import { leftOutList } from "./left_out.js";
import { metreStick } from "./metre.js";
import { fileName, keepPlace, renamePlace } from "./places.js";
import { upOf } from "./up.js";
import { upSliders } from "./up_sliders.js";
import { duration, plural } from "./words.js";

export async function resultStep(flow, { scene, report, name }) {
  const { film } = flow;
  const mapper = await flow.mapper();
  const registered = report.pictures.filter((picture) => picture.registered);
  const missing = report.pictures.filter((picture) => !picture.registered);
  const place = { scene, name, kept: undefined, report };
  let View;
  let view;
  let left = false;

  const kept = el("p", { class: "fine", id: "map-kept", role: "status" });
  const frame = el("div", { class: "map-result-view map-frame", id: "map-result-view" });
  const viewNote = el("p", { class: "map-note" }, "Loading the 3D view…");
  frame.append(viewNote);
  const field = el("input", { type: "text", id: "map-name", value: name, maxLength: 80, autocomplete: "off" });

  /** Keeps the place under its name; where that cannot be, the words say what can. */
  const keep = async () => {
    if (!canKeep()) return void (kept.textContent = cannotKeepWords);
    try {
      place.kept = await keepPlace(place.scene, { name: place.name, pictures: registered.length, metric: place.report.units === "metres" }, place.kept?.id);
      kept.textContent = `Kept in My places as “${place.name}”, ${bytes(place.kept.bytes)}.`;
      // The map is there: the film is needed no more when this page is gone.
      await film.discard();
    } catch (error) {
      kept.textContent = `Not kept: ${error.message}. ${error.hint ?? ""}`;
      again.hidden = false;
      return;
    }
    again.hidden = true;
  };
  const again = button("Keep it now", keep, { kind: "small-button", id: "map-keep", hidden: true });
  /** The same place in metres, or with another up; answers with what is known of it then. */
  const rewrite = async (what) => {
    ({ scene: place.scene, report: place.report } = await mapper.write({ name: place.name, ...what }));
    if (what.scale) showIn3d();
    await keep();
    return place.report;
  };
  /** Once its module is there: it may come late, or never where there is no WebGL, and the map is no worse for it. */
  const showIn3d = () => {
    view?.dispose();
    view = View && new View(frame, place.report);
  };

  field.addEventListener("change", async () => {
    place.name = field.value.trim() || name;
    if (!place.kept) return;
    try {
      await renamePlace(place.kept, place.name);
      place.kept.name = place.name;
      kept.textContent = `Kept in My places as “${place.name}”.`;
    } catch (error) {
      kept.textContent = `The name was not changed: ${error.message}.`;
    }
  });

  const all = report.pictures.length;
  const facts = [`${registered.length} of ${plural(all, "picture")} found their place`, plural(report.points, "point"), plural(report.lines, "line"), `${report.medianReprojection.toFixed(1)} px off in the median`, ...(report.seconds >= 1 ? [`made in ${duration(report.seconds)}`] : [])];
  flow.show(
    "result",
    [
      heading(registered.length < all / 2 ? "A part of your place is mapped" : "Your place is mapped"),
      el("p", { id: "map-summary" }, `${facts.join(" · ")}.`),
      ...report.warnings.map((text) => el("p", { class: "problem-hint" }, text)),
      el("div", { class: "map-ways" }, button("Try it", () => flow.tryPlace(place.scene, place.name), { kind: "button button-main", id: "map-try" }), button("Save as a file", () => save(fileName(place.name), place.scene, "application/octet-stream"), { id: "map-save" })),
      el("label", { class: "map-name" }, "Name ", field),
      el("div", { class: "row" }, kept, again),
      frame,
      el("p", { class: "fine" }, "Orange: lines. Blue: points. White: where the camera stood, with its way in green."),
      problems(missing, film?.leftOut ?? []),
      metreStick({ film, report, rewrite }),
      upSliders({ up: () => upOf(place.report), preview: (up) => view?.setUp(up), rewrite, frame }),
      furtherTraining(mapper, place),
      el("div", { class: "map-ways" }, button("Done", async () => {
        await flow.discardFilm();
        await flow.toBegin();
      }, { id: "map-done" })),
    ].filter(Boolean),
    () => {
      left = true;
      view?.dispose();
      // A film whose place is kept is done with.
      if (place.kept) void flow.discardFilm();
    },
  );
  await keep();
  try {
    const { ResultView } = await import("./result_view.js");
    if (left) return;
    view = new ResultView(frame, place.report);
    View = ResultView;
    viewNote.remove();
  } catch (error) {
    viewNote.textContent = `The 3D view needs WebGL, which this browser does not give (${error.message}). The map itself is not affected.`;
  }
}

/** The way out for who wants more of the place than the page can make. */
function furtherTraining(mapper, place) {
  const said = el("p", { class: "fine", id: "map-labels-said", role: "status" });
  const get = button("Save features and tracks", async () => {
    try {
      const labels = await mapper.labels();
      const name = fileName(place.name).replace(/landline$/, "labels");
      save(name, labels, "application/octet-stream");
      said.textContent = `${name}, ${bytes(labels.byteLength)}.`;
    } catch (error) {
      said.textContent = `Not saved: ${error.message}.`;
    }
  }, { kind: "small-button", id: "map-labels" });
  return el(
    "details",
    { class: "map-card", id: "map-training" },
    el("summary", {}, "Train it further"),
    el("p", {}, "On a computer the native tool makes a scene with trained networks of what this film saw; no picture is in the file."),
    el("code", {}, "landline train NAME.labels --extractor xfeat.safetensors --out NAME.landline"),
    el("div", { class: "row" }, get, said),
  );
}

/** What did not become part of the map, and why. */
const problems = (missing, leftOut) => leftOutList([...missing.map(({ name, keyframe, reason, advice }) => [name ?? `Picture ${keyframe + 1}`, advice ?? reason?.replaceAll("-", " ") ?? "no position was found"]), ...leftOut]);
