/** Two sliders that set the map upright. */
import { button, el } from "./elements.js";
import { tilted } from "./up.js";

/**
 * `up` tells what is up at present, `preview` shows another at once, `rewrite` writes it into the place. `frame` has the 3D
 * view, which comes to the sliders while they are open: on a phone it is out of sight else.
 */
export function upSliders({ up, preview, rewrite, frame }) {
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
  const home = document.createComment("");
  const words = el("p", {}, "Up is guessed from how the camera was held. Tilt until the grid lies on the floor.");
  const move = () => {
    if (!details.open) return home.replaceWith(frame);
    if (home.parentNode) return;
    frame.replaceWith(home);
    words.after(frame);
  };
  const details = el(
    "details",
    { class: "map-card", id: "map-up", ontoggle: move },
    el("summary", {}, "Is the floor level?"),
    words,
    el("label", { class: "slider" }, "Forwards ", forward),
    el("label", { class: "slider" }, "Sideways ", sideways),
    el("div", { class: "row" }, button("This is up", set, { kind: "small-button", id: "map-set-up" }), said),
  );
  return details;
}
