// A film through `landline/mapper` in headless Chromium, one thread, CPU: what map_node.mjs measures, as a page meets it.
//
//   node benches/map_browser.mjs PACKAGE PICTURES [STEP] [FIRST] [END] [POSES FOCAL] > out.json
//
// PACKAGE is dist/npm/landline, PICTURES a folder of JPEG or PNG files, with folders in it or none, taken by their place in the
// sorted list. Those from FIRST to before END in steps are the film, up to a hundred from END on are located. POSES, a list
// of `NAME QW QX QY QZ TX TY TZ` (camera from world), and FOCAL give the film's frames their poses and their camera. Memory is the peak resident size of
// the page's process. CHROME names the browser.
import { readdir } from "node:fs/promises";
import { basename, join, normalize, resolve } from "node:path";
import { blankPage, renderers, root } from "./blank_page.mjs";
import { range } from "./map_film.mjs";
import { readPoses } from "./pose_list.mjs";

const [packageFolder, pictures, step = "7", first = "0", end = "800", posesFile, focal] = process.argv.slice(2);
if (!pictures || (posesFile && !focal)) throw new Error("usage: node benches/map_browser.mjs PACKAGE PICTURES [STEP] [FIRST] [END] [POSES FOCAL]");
const names = (await readdir(pictures, { recursive: true })).filter((name) => /\.(jpe?g|png)$/i.test(name)).sort();
const film = range(Number(first), Number(end), Number(step)).filter((i) => i < names.length);
const test = range(Number(end), Math.min(names.length, Number(end) + 100));

let poses;
if (posesFile) {
  const known = await readPoses(posesFile);
  poses = Object.fromEntries(film.map((i) => [i, known.get(names[i])]));
}

const bases = { package: resolve(packageFolder), pictures: resolve(pictures), benches: join(root, "benches") };
const { page, browser, close } = await blankPage((path) => {
  const [, folder, ...rest] = path.split("/");
  const base = bases[folder];
  const file = base && join(base, normalize(rest.join("/")));
  return file?.startsWith(base) ? file : undefined;
}, 3_600_000);
page.on("console", (message) => console.error(message.text()));
page.on("pageerror", (error) => console.error(error));

console.error(`Chromium ${browser.version()}, ${film.length} frames of film, ${test.length} to be located`);
const result = await page.evaluate(
  async ({ names, film, test, poses, focal }) => {
    const { Mapper } = await import("/package/mapper/index.js");
    const { Relocalizer } = await import("/package/index.js");
    const { mapFilm } = await import("/benches/map_film.mjs");
    const frame = async (i) => createImageBitmap(await (await fetch(`/pictures/${names[i]}`)).blob(), { colorSpaceConversion: "none" });
    return mapFilm({ Mapper, Relocalizer, frame, film, test, poses, focal, say: (text) => console.log(text) });
  },
  { names, film, test, poses, focal: Number(focal) },
);
const peaks = renderers().map(({ peak }) => peak);
if (peaks.length > 0) console.error(`the page's process: at most ${Math.round(Math.max(...peaks))} MB`);
const named = (rows) => rows.map(({ name, pose }) => ({ name: names[Number(name)], pose }));
console.log(JSON.stringify({ placed: named(result.placed), found: named(result.found) }));
await close();
