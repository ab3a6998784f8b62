/** Two sliders that set the map upright. */
import { button, el } from "./elements.js";
import { tilted } from "./up.js";

/** `up` tells what is up at present, `preview` shows another at once, `rewrite` writes it into the place. */
export function upSliders(up, preview, rewrite) {
  const said = el("p", { class: "fine", role: "status" });
  const slider = (id) => el("input", { type: "range", id, min: -60, max: 60, step: 1, value: 0, oninput: () => preview(now()) });
  const [forward, sideways] = [slider("map-tilt-forward"), slider("map-tilt-sideways")];
  const now = () => tilted(up(), Number(forward.value), Number(sideways.value));
  const set = async () => {
    try {
      await rewrite({ up: now() });
      forward.value = sideways.value = 0;
      said.textContent = "This is up now.";
    } catch (error) {
      said.textContent = `Not changed: ${error.message}.`;
    }
  };
  return el(
    "details",
    { class: "map-card", id: "map-up" },
    el("summary", {}, "Is the floor level?"),
    el("p", {}, "Up is taken from how the device was held. Tilt until the grid lies on the floor."),
    el("label", { class: "slider" }, "Forwards ", forward),
    el("label", { class: "slider" }, "Sideways ", sideways),
    el("div", { class: "row" }, button("This is up", set, { kind: "small-button", id: "map-set-up" }), said),
  );
}
