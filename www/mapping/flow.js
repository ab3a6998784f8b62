/**
 * “Map this place”: a dialog over the page that goes from filming to a place that can be located in. Loaded when it is
 * asked for; a page that only locates never loads this folder.
 */
import { startCamera } from "../live.js";
import { loadScene, showEmpty } from "../loading.js";
import { loadMapper } from "../mapper.js";
import { markSource, state, stopSource } from "../session.js";
import { setPlaying } from "../strip.js";
import { beginStep } from "./begin.js";
import { buildStep } from "./build.js";
import { Announcer, el } from "./elements.js";
import { Film } from "./film.js";
import { filmStep } from "./film_step.js";
import { heldStep } from "./held.js";
import { placeFile } from "./places.js";
import { resultStep } from "./result.js";
import { failure } from "./words.js";

let flow;

/** Opens the dialog; what an earlier visit left unfinished is offered again. */
export async function openFlow() {
  flow ??= new Flow();
  await flow.open();
}

/** The dialog and what its steps share. A step is given this object and says by its methods what comes next. */
class Flow {
  announcer = new Announcer();
  film;
  #mapper;
  #making;
  #leave = () => {};
  #body = el("div", { class: "mapping-body" });
  #dialog = el("dialog", { id: "mapping", class: "mapping", "aria-labelledby": "mapping-title" });

  constructor() {
    const close = el("button", { type: "button", class: "icon-button mapping-close", "aria-label": "Close", onclick: () => this.close() }, "✕");
    this.#dialog.append(close, this.#body, this.announcer.element);
    this.#dialog.addEventListener("cancel", (event) => {
      event.preventDefault();
      this.close();
    });
    document.body.append(this.#dialog);
  }

  async open() {
    await styled();
    setPlaying(false);
    if (!this.#dialog.open) this.#dialog.showModal();
    await this.toBegin();
  }

  /** Closes the dialog. What was filmed stays, and is offered when the dialog is opened again. */
  close() {
    this.#leaveStep();
    this.#dialog.close();
    void this.release();
  }

  #leaveStep() {
    const leave = this.#leave;
    this.#leave = () => {};
    leave();
  }

  /** Shows a step; `leave` frees what it holds. */
  show(name, nodes, leave = () => {}) {
    this.#leaveStep();
    this.#leave = leave;
    this.#dialog.dataset.step = name;
    this.#body.replaceChildren(...nodes);
    this.#body.scrollTop = 0;
    this.#body.querySelector("h2")?.focus({ preventScroll: true });
  }

  /** True while this step is shown. */
  isAt(name) {
    return this.#dialog.open && this.#dialog.dataset.step === name;
  }

  /** The mapper, made when it is first needed; `onProgress` hears of its downloads. */
  async mapper(onProgress) {
    if (this.#mapper) return this.#mapper;
    this.#making ??= (async () => {
      const { Mapper } = await loadMapper();
      return Mapper.create({ onProgress });
    })();
    try {
      this.#mapper = await this.#making;
      return this.#mapper;
    } finally {
      this.#making = undefined;
    }
  }

  /** Frees the mapper with its memory; pictures that are kept can be given to another one. */
  async release() {
    const mapper = this.#mapper;
    this.#mapper = undefined;
    await mapper?.dispose();
  }

  /** True when the mapper has seen what the film holds. */
  isFed() {
    return this.#mapper !== undefined && this.film !== undefined && this.#mapper.keyframes === this.film.pictures.length;
  }

  async toBegin() {
    const left = this.film?.pictures.length ? this.film : await Film.left();
    await beginStep(this, left);
  }

  /** `source` is `camera`, `video` or `pictures`; `more` goes on with the film that is there. */
  async toFilm(source, files, { more = false } = {}) {
    if (state.live) {
      await stopSource();
      markSource("");
      showEmpty("Nothing is shown", "Choose the sample, a picture or the camera.");
    }
    if (!more || !this.film) {
      await this.release();
      this.film = await Film.begin(source);
    }
    await filmStep(this, source, files);
  }

  /** Goes on with a film that an earlier visit left. */
  takeUp(film) {
    this.film = film;
  }

  toBuild() {
    return buildStep(this);
  }

  /** The film is there and no map of it: `words` say why. */
  toHeld(words) {
    heldStep(this, words);
  }

  /** As above, after something went wrong. A mapper that is broken is replaced. */
  async toFailure(error) {
    if (["engine-defect", "out-of-memory", "disposed"].includes(error?.code)) await this.release().catch(() => undefined);
    this.toHeld(failure(error));
  }

  toResult(outcome) {
    return resultStep(this, outcome);
  }

  /** The film has served its purpose, or is not wanted. */
  async discardFilm() {
    const { film } = this;
    this.film = undefined;
    await film?.discard();
    await this.release();
  }

  /** Locates in a place at once: with the camera where there is one. */
  async tryPlace(scene, name) {
    this.close();
    if (!(await loadScene(placeFile(scene, name), name, false))) return;
    markSource("scene");
    const devices = (await navigator.mediaDevices?.enumerateDevices?.().catch(() => [])) ?? [];
    if (devices.some(({ kind }) => kind === "videoinput")) await startCamera();
  }
}

/** The dialog's style sheet, once. */
function styled() {
  const id = "mapping-style";
  if (document.getElementById(id)) return undefined;
  const link = el("link", { id, rel: "stylesheet", href: new URL("mapping.css", import.meta.url).href });
  return new Promise((done) => {
    link.addEventListener("load", done, { once: true });
    // Without its looks the dialog still works.
    link.addEventListener("error", done, { once: true });
    document.head.append(link);
  });
}
