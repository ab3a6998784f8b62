/** A place of many rooms: its floor plan under the picture, which room the camera is in, and links to rooms. */
import { Place } from "landline/place";
import { $ } from "../dom.js";
import { showEmpty, takeUp } from "../loading.js";
import { el } from "../mapping/elements.js";
import { bytes, extractorName, facts, roomName, sentence } from "../panels.js";
import { markSource, state } from "../session.js";
import { forgetPlace } from "../stage.js";
import { FloorPlan } from "./plan.js";
import { qrCode } from "./qr.js";

/** Opens the place at an address; `near` is a room in which the camera probably is. True when it is there. */
export async function openPlace(address, near) {
  const name = address.split("/").pop().replace(/\.place\.json$/, "");
  let card;
  const opened = await takeUp({
    name,
    retry: () => openPlace(address, near),
    make: async (common) => {
      const onProgress = (event) => {
        // Rooms are loaded as they are needed, long after the place.
        if (event.file === "scene") card?.loading(event);
        else common.onProgress(event);
      };
      const [place] = await Promise.all([Place.create({ ...common, onProgress, place: address }), styled()]);
      return place;
    },
    taken: (place) => {
      state.scene = { name, isSample: false, isPlace: true, again: () => openPlace(address, near) };
      card = new PlaceCard(place, address);
      state.leave = () => card.remove();
      const { rooms, name: title } = place.manifest;
      facts($("scene-facts"), [
        ["Name", title || name],
        ["Rooms", String(rooms.length)],
        ["Size", `${bytes(rooms.reduce((sum, { scene }) => sum + scene.bytes, 0))}, loaded room by room`],
        ["Features", extractorName(place.manifest.extractor)],
      ]);
      showEmpty(title || "The place is loaded", `Now choose a picture or a video of one of its ${rooms.length} rooms, or use the camera there.`);
    },
  });
  if (!opened) return false;
  markSource("");
  if (near !== undefined) card.expect(near);
  return true;
}

/** The card with the plan. */
class PlaceCard {
  #place;
  #address;
  #plan;
  #where = el("p", { class: "plan-where", role: "status" });
  #note = el("p", { class: "fine" });
  #others = el("p", { class: "fine" });
  #link = el("a", { class: "plan-link" });
  #qr = el("div", { class: "plan-qr" });
  #element;

  constructor(place, address) {
    this.#place = place;
    this.#address = address;
    this.#plan = new FloorPlan(place.manifest);
    const copy = el("button", { type: "button", class: "small-button", onclick: () => void this.#share(copy) }, "Copy link");
    const details = el("details", {}, el("summary", {}, "QR code"), this.#qr);
    const words = el("div", { class: "plan-words" }, el("h2", {}, "Where you are"), this.#where, this.#note, this.#others, el("div", { class: "row" }, copy, this.#link), details);
    this.#element = el("article", { class: "panel card plan", id: "plan" }, this.#plan.element, words);
    $("stage").after(this.#element);
    place.on("room", ({ room }) => {
      // Its world is another one, with another up.
      forgetPlace();
      this.#show(room);
    });
    place.on("result", (result) => this.#result(result));
    place.on("refused", ({ room, error }) => (this.#note.textContent = `${roomName(room)} could not be loaded. ${sentence(error.message)}`));
    this.#where.textContent = "Not known yet.";
    this.#show(undefined);
  }

  remove() {
    this.#element.remove();
  }

  /** Loads the room that an address names, before any picture. */
  expect(id) {
    const room = this.#place.manifest.rooms.find((other) => other.id === id);
    if (!room) {
      this.#note.textContent = `The address names the room “${id}”, which this place does not have.`;
      return;
    }
    this.#show(room);
    this.#plan.mark(undefined, [id]);
    this.#where.textContent = `Probably in ${roomName(room)}.`;
    void this.#place.load(id);
  }

  /** Bytes of a room's scene that have come. */
  loading({ status, url, loaded, total }) {
    if (status === "done") this.#note.textContent = "";
    if (status !== "download") return;
    const room = this.#place.manifest.rooms.find(({ scene }) => new URL(scene.url, this.#address).href === url);
    this.#note.textContent = `Loading ${room ? roomName(room) : "a room"}: ${bytes(loaded)}${total > 0 ? ` of ${bytes(total)}` : ""}`;
  }

  #show(room) {
    const { others, isAlone, floor } = this.#plan.show(room);
    const names = others.map(roomName);
    const whole = isAlone && room ? "Where this room stands in the place is not known. " : floor === undefined ? "" : `Floor ${floor}. `;
    this.#others.textContent = `${whole}${names.length > 0 ? `Not on this plan: ${names.slice(0, 12).join(", ")}${names.length > 12 ? ` and ${names.length - 12} more` : ""}.` : ""}`;
    this.#linkTo(room);
  }

  #result(result) {
    const { room, rivals } = result;
    this.#plan.mark(room?.id, rivals);
    this.#plan.point(room ? (result.placementInPlace ?? result.placement) : undefined);
    const before = this.#place.room;
    const words = room ? `In ${roomName(room)}.` : rivals ? `In one of two rooms that look alike: ${rivals.join(", ")}.` : before ? `Not seen now; last in ${roomName(before)}.` : "Not known yet.";
    // Read aloud, so only when it changes.
    if (this.#where.textContent !== words) this.#where.textContent = words;
  }

  /** The link and its code: to the place, or to a room of it. */
  #linkTo(room) {
    const url = new URL(location.pathname, location.href);
    const { pathname } = new URL(this.#address);
    const folder = url.pathname.replace(/[^/]*$/, "");
    url.searchParams.set("place", pathname.startsWith(folder) ? pathname.slice(folder.length) : pathname);
    if (room) url.searchParams.set("room", room.id);
    this.#link.href = url.href;
    this.#link.textContent = room ? `Link to ${roomName(room)}` : "Link to this place";
    this.#qr.replaceChildren(drawing(url.href));
  }

  async #share(button) {
    try {
      await navigator.clipboard.writeText(this.#link.href);
      button.textContent = "Copied";
    } catch {
      button.textContent = "Copy the link itself";
    }
    setTimeout(() => (button.textContent = "Copy link"), 1500);
  }
}

/** A QR code as a picture, dark on light whatever the page's colours are. */
function drawing(text) {
  const rows = qrCode(text);
  if (!rows) return el("p", { class: "fine" }, "The link is too long for a code.");
  const margin = 4;
  const scale = 4;
  const side = rows.length + 2 * margin;
  const canvas = el("canvas", { width: scale * side, height: scale * side, role: "img", "aria-label": `QR code of ${text}` });
  const context = canvas.getContext("2d");
  context.fillStyle = "#fff";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.fillStyle = "#000";
  rows.forEach((row, y) => row.forEach((dark, x) => dark && context.fillRect(scale * (x + margin), scale * (y + margin), scale, scale)));
  return canvas;
}

function styled() {
  const id = "plan-style";
  if (document.getElementById(id)) return undefined;
  const link = el("link", { id, rel: "stylesheet", href: new URL("plan.css", import.meta.url).href });
  return new Promise((done) => {
    link.addEventListener("load", done, { once: true });
    // Without its looks the plan still works.
    link.addEventListener("error", done, { once: true });
    document.head.append(link);
  });
}
