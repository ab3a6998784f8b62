/** Short ways to make elements. Text is always text, never markup. */

/** An element with properties (`class`, `on…` listeners, ARIA and data attributes by their names) and children. */
export function el(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (value === undefined) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name === "class") element.className = value;
    else if (/^(aria|data)-|^(role|for)$/.test(name)) element.setAttribute(name, value);
    else element[name] = value;
  }
  element.append(...children.filter((child) => child !== undefined && child !== ""));
  return element;
}

/** A button; the first kind is the one that most people want next. */
export const button = (text, act, { kind = "button", ...more } = {}) => el("button", { type: "button", class: kind, onclick: () => void act(), ...more }, text);

/** A heading that takes the focus when its step appears, so that screen readers begin there. */
export const heading = (text) => el("h2", { tabIndex: -1, id: "mapping-title" }, text);

/** Text that is read aloud when it changes; at most every three seconds, and never the same twice in a row. */
export class Announcer {
  element = el("p", { class: "sr", role: "status" });
  #at = 0;

  say(text) {
    const now = performance.now();
    if (text === this.element.textContent || now - this.#at < 3000) return;
    this.#at = now;
    this.element.textContent = text;
  }
}
