/** My places: each can be tried, renamed, exported, deleted. */
import { bytes } from "../panels.js";
import { save } from "../report.js";
import { button, el } from "./elements.js";
import { canKeep, cannotKeepWords } from "./files.js";
import { deletePlace, fileName, listPlaces, renamePlace, room, sceneOf } from "./places.js";
import { plural } from "./words.js";

/** The section with the list. Its buttons change it in place. */
export async function placesList(flow) {
  const section = el("section", { class: "map-places", "aria-labelledby": "map-places-title" });
  await fill(section, flow);
  return section;
}

async function fill(section, flow, said = "") {
  const title = el("h3", { id: "map-places-title", tabIndex: -1 }, "My places");
  const note = el("p", { class: "fine", role: "status" }, said);
  if (!canKeep()) return section.replaceChildren(title, el("p", { class: "fine" }, cannotKeepWords));
  let places;
  try {
    places = await listPlaces();
  } catch (error) {
    return section.replaceChildren(title, el("p", { class: "fine" }, `They cannot be read: ${error.message}.`));
  }
  const again = (words) => fill(section, flow, words).then(() => title.isConnected || section.querySelector("h3")?.focus());
  const free = await room();
  const total = places.reduce((sum, { bytes: size }) => sum + size, 0);
  const summary = places.length === 0 ? "None yet. A place that you map is kept here, on this device only." : `${plural(places.length, "place")}, ${bytes(total)}${free === undefined ? "" : `; room for ${bytes(free)} more`}.`;
  section.replaceChildren(title, el("p", { class: "fine" }, summary), el("ul", { class: "map-list" }, ...places.map((place) => row(place, flow, again, note))), note);
}

function row(place, flow, again, note) {
  const about = [bytes(place.bytes), plural(place.pictures, "picture"), new Date(place.created).toLocaleDateString("en-GB"), ...(place.metric ? ["in metres"] : [])].join(" · ");
  const buttons = el("div", { class: "row" });
  const line = el("li", {}, el("div", { class: "map-place" }, el("strong", {}, place.name), el("span", { class: "fine" }, about)), buttons);
  /** Runs an action; what goes wrong is said below the list. */
  const act = (work) => async () => {
    try {
      await work();
    } catch (error) {
      note.textContent = `${place.name}: ${error.message}. ${error.hint ?? ""}`;
    }
  };
  const small = (text, work) => button(text, act(work), { kind: "small-button", "aria-label": `${text}: ${place.name}` });
  const usual = () =>
    buttons.replaceChildren(
      small("Try it", async () => flow.tryPlace(await sceneOf(place), place.name)),
      small("Rename", rename),
      small("Export", async () => save(fileName(place.name), await sceneOf(place), "application/octet-stream")),
      small("Delete", askDelete),
    );
  const rename = () => {
    const input = el("input", { type: "text", value: place.name, maxLength: 80, "aria-label": "New name" });
    const done = act(async () => {
      const name = input.value.trim();
      if (name && name !== place.name) await renamePlace(place, name);
      await again(name ? `Renamed to ${name}.` : "");
    });
    input.addEventListener("keydown", (event) => {
      if (event.key === "Enter") void done();
      if (event.key !== "Escape") return;
      // The key leaves the field, not the dialog.
      event.preventDefault();
      usual();
      buttons.children[1].focus();
    });
    buttons.replaceChildren(input, small("Save name", done), small("Cancel", usual));
    input.select();
  };
  const askDelete = () => {
    buttons.replaceChildren(
      small("Delete for good", async () => {
        await deletePlace(place);
        await again(`${place.name} is deleted.`);
      }),
      small("Keep", usual),
    );
    buttons.lastChild.focus();
  };
  usual();
  return line;
}
