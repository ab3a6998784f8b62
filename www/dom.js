/** Short ways to the page's elements and to its address. */

export const $ = (id) => document.getElementById(id);

/** `?scene=` an address, `?device=` auto, webgpu or cpu, `?dwell=` milliseconds per sample picture, `?no-offline`. */
export const query = new URLSearchParams(location.search);

/** Waits until something holds. */
export async function until(condition) {
  while (!condition()) await new Promise((done) => setTimeout(done, 40));
}
