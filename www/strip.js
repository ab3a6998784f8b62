/** The row of small pictures and the buttons beside it. */
import { $ } from "./dom.js";
import { state } from "./session.js";

/** Thumbnails that wait until a position stands on the page: before that they would only be in the way. */
let waiting = [];

/** Loads them. */
export function loadThumbs() {
  for (const load of waiting.splice(0)) load();
}

/** One button per picture of the list; `choose` is called with its number. */
export function showStrip(choose) {
  waiting = [];
  $("strip").replaceChildren(
    ...state.playlist.map((item, i) => {
      const button = document.createElement("button");
      button.type = "button";
      button.className = "thumb";
      button.id = `thumb-${i}`;
      button.setAttribute("role", "option");
      button.setAttribute("aria-selected", "false");
      button.setAttribute("aria-label", item.name);
      button.tabIndex = -1;
      if (item.thumb) {
        const image = document.createElement("img");
        // Files of this device need no download.
        if (item.thumb.startsWith("blob:")) image.src = item.thumb;
        else waiting.push(() => (image.src = item.thumb));
        image.alt = "";
        image.loading = "lazy";
        image.decoding = "async";
        image.addEventListener("error", () => (button.textContent = String(i + 1)), { once: true });
        button.append(image);
      } else {
        button.textContent = String(i + 1);
      }
      button.addEventListener("click", () => choose(i));
      return button;
    }),
  );
  $("strip").hidden = state.playlist.length === 0;
  $("previous").disabled = $("next").disabled = state.playlist.length < 2;
}

/** Marks the picture that is being looked at, while an earlier one is still shown. */
export function markNext(index) {
  [...$("strip").children].forEach((thumb, i) => thumb.toggleAttribute("data-next", i === index));
}

/** Marks the picture that is shown. */
export function markThumb(index) {
  const strip = $("strip");
  [...strip.children].forEach((thumb, i) => thumb.setAttribute("aria-selected", String(i === index)));
  markNext(-1);
  const thumb = strip.children[index];
  if (!thumb) return;
  strip.setAttribute("aria-activedescendant", thumb.id);
  strip.scrollTo({ left: thumb.offsetLeft - strip.offsetLeft - strip.clientWidth / 2 + thumb.clientWidth / 2, behavior: "instant" });
}

/** Marks how a picture ended. */
export function markResult(index, located) {
  const thumb = $("strip").children[index];
  if (!thumb) return;
  thumb.dataset.result = located ? "located" : "not-located";
  thumb.setAttribute("aria-label", `${state.playlist[index]?.name ?? ""}, ${located ? "located" : "not located"}`);
}

/** Sets whether the list or the video goes on by itself. */
export function setPlaying(playing) {
  state.playing = playing;
  $("play").setAttribute("aria-label", playing ? "Pause" : "Play");
  $("icon-pause").toggleAttribute("hidden", !playing);
  $("icon-play").toggleAttribute("hidden", playing);
}
