/** The metre stick: two points are marked in a picture, their distance is typed, and the place has metres. */
import { sentence } from "../panels.js";
import { button, el } from "./elements.js";

/** Length of the way between the cameras: what people know of their own film. */
function walk(pictures) {
  const at = pictures.flatMap(({ placement }) => (placement ? [placement.position] : []));
  return at.slice(1).reduce((sum, b, i) => sum + Math.hypot(b.x - at[i].x, b.y - at[i].y, b.z - at[i].z), 0);
}

/** What to do where the map knows nothing near a mark: the engine's own words are for programs. */
const unknownMark = ({ code, message }) => (code === "bad-input" && /nothing is known in space/.test(message) ? "The map knows nothing in space near one of the marks. Mark corners or edges, in another picture if this one has none." : undefined);

/** `rewrite` writes the scale into the place. */
export function metreStick({ film, report, rewrite }) {
  const usable = report.pictures.filter(({ registered, keyframe }) => registered && film?.picture(keyframe));
  if (usable.length === 0) return undefined;
  const canvas = el("canvas", { id: "map-metre-picture", tabIndex: 0, role: "application", "aria-label": "Picture to mark two points in. Arrow keys move the cross, Enter marks." });
  const said = el("p", { class: "fine", id: "map-metre-said", role: "status" }, "The picture is being read.");
  const distance = el("input", { type: "number", id: "map-metre-distance", inputMode: "decimal", min: 0, step: "any", placeholder: "1.20" });
  const set = button("Set the scale", () => apply(), { kind: "small-button", id: "map-metre-set", disabled: true });
  let index = Math.floor(usable.length / 2);
  let bitmap;
  let cursor;
  /** `{ u, v }`: shares of the picture's width and height. */
  let marks = [];

  const draw = () => {
    if (!bitmap) return;
    if (canvas.width !== bitmap.width || canvas.height !== bitmap.height) [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
    const context = canvas.getContext("2d");
    context.drawImage(bitmap, 0, 0);
    const size = Math.max(bitmap.width, bitmap.height) / 60;
    const cross = ({ u, v }, color) => {
      const [x, y] = [u * bitmap.width, v * bitmap.height];
      for (const [width, style] of [[size / 2.2, "#000a"], [size / 5, color]]) {
        context.lineWidth = width;
        context.strokeStyle = style;
        context.beginPath();
        context.moveTo(x - size, y);
        context.lineTo(x + size, y);
        context.moveTo(x, y - size);
        context.lineTo(x, y + size);
        context.stroke();
      }
    };
    if (marks.length === 2) {
      context.lineWidth = size / 5;
      context.strokeStyle = "#ffb057";
      context.beginPath();
      context.moveTo(marks[0].u * bitmap.width, marks[0].v * bitmap.height);
      context.lineTo(marks[1].u * bitmap.width, marks[1].v * bitmap.height);
      context.stroke();
    }
    marks.forEach((mark) => cross(mark, "#ffb057"));
    if (cursor) cross(cursor, "#ffffff");
  };
  const mark = (u, v) => {
    // A picture that is not there yet has no points.
    if (!bitmap) return;
    if (marks.length === 2) marks = [];
    marks.push({ u, v });
    said.textContent = marks.length === 1 ? "Now the second point." : "Type how far apart they are.";
    set.disabled = marks.length < 2;
    draw();
    if (marks.length === 2) distance.focus();
  };
  canvas.addEventListener("click", (event) => {
    const box = canvas.getBoundingClientRect();
    mark((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  });
  canvas.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    const at = cursor ?? { u: 0.5, v: 0.5 };
    if (moves[event.key]) {
      const by = event.shiftKey ? 0.05 : 0.01;
      const [u, v] = [at.u + by * moves[event.key][0], at.v + by * moves[event.key][1]].map((value) => Math.min(0.995, Math.max(0.005, value)));
      cursor = { u, v };
      draw();
    } else if (event.key === "Enter" || event.key === " ") mark(at.u, at.v);
    else return;
    event.preventDefault();
  });
  const apply = async () => {
    const metres = Number(distance.value);
    if (!(metres > 0) || marks.length < 2) return void (said.textContent = "Mark two points and type their distance in metres.");
    // Pixels of the frames that the mapper saw; the pictures that are kept may be smaller.
    const [from, to] = marks.map(({ u, v }) => ({ keyframe: usable[index].keyframe, x: u * report.width, y: v * report.height }));
    try {
      const { pictures } = await rewrite({ scale: { from, to, metres } });
      said.textContent = `Lengths are in metres now. By this scale your walk was ${walk(pictures).toFixed(1)} m long; if that is far off, mark other points.`;
      set.disabled = true;
    } catch (error) {
      said.textContent = `The scale was not set. ${unknownMark(error) ?? `${sentence(error.message)} ${error.hint ?? ""}`.trim()}`;
    }
  };
  const choose = async (by) => {
    index = (index + by + usable.length) % usable.length;
    marks = [];
    said.textContent = "The picture is being read.";
    set.disabled = true;
    bitmap?.close();
    bitmap = undefined;
    const chosen = index;
    const read = await createImageBitmap(film.picture(usable[chosen].keyframe).blob);
    // Another picture was asked for in the meantime.
    if (chosen !== index || bitmap) return read.close();
    bitmap = read;
    said.textContent = "Tap the first point.";
    draw();
  };
  const details = el(
    "details",
    { class: "map-card", id: "map-metre", ontoggle: () => details.open && !bitmap && void choose(0) },
    el("summary", {}, "Give it metres"),
    el("p", {}, "Pictures alone do not tell how large a place is. Mark two points whose distance you know, a door’s width for example."),
    canvas,
    el("div", { class: "row" }, button("Previous picture", () => choose(-1), { kind: "small-button" }), button("Next picture", () => choose(1), { kind: "small-button" })),
    said,
    el("div", { class: "row map-measure" }, el("label", {}, "Their distance in metres ", distance), set),
  );
  return details;
}
