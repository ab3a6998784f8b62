// What map_node.mjs and map_browser.mjs do: a film becomes a scene, pictures that were not in it are located there.

/**
 * `frame(i)` is frame number i, `poses` maps a number to its `cameraFromWorld` (16 numbers, row-major) or is absent, and then
 * `focal` is the focal length of its frames in pixels, `clock()` is the processor time in seconds where that is known. Resolves to what was placed and found.
 */
export async function mapFilm({ Mapper, Relocalizer, frame, film, test, poses, focal, clock = () => NaN, say }) {
  const seconds = (from) => ((performance.now() - from) / 1000).toFixed(1);
  const mapper = await Mapper.create();
  const filming = performance.now();
  for (const i of film) {
    const picture = await frame(i);
    const { width, height } = picture;
    const posed = poses && { pose: poses[i], intrinsics: { fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height } };
    await mapper.addFrame(picture, { name: String(i), ...posed });
  }
  say(`film ${seconds(filming)} s ${JSON.stringify(mapper.coverage)}`);

  const [building, before] = [performance.now(), clock()];
  const stages = {};
  let [last, longest] = [building, 0];
  const onProgress = ({ stage }) => {
    const now = performance.now();
    stages[stage] = (stages[stage] ?? 0) + (now - last) / 1000;
    longest = Math.max(longest, now - last);
    last = now;
  };
  const { scene, report } = await mapper.build({ onProgress });
  say(`build ${seconds(building)} s, ${(clock() - before).toFixed(1)} s of processor, longest step ${(longest / 1000).toFixed(1)} s`);
  say(`${JSON.stringify(stages)} ${JSON.stringify(await mapper.memory())}`);
  const { pictures, cloud: _, ...rest } = report;
  say(`${JSON.stringify(rest)}, ${scene.length} bytes`);
  await mapper.dispose();

  const relocalizer = await Relocalizer.create({ scene, device: "cpu" });
  const found = [];
  for (const i of test) {
    const { placement } = await relocalizer.locate(await frame(i));
    found.push({ name: String(i), pose: placement ? [...placement.cameraFromWorld] : null });
  }
  await relocalizer.dispose();
  const placed = pictures.map(({ name, placement }) => ({ name, pose: placement ? [...placement.cameraFromWorld] : null }));
  return { placed, found };
}

/** Numbers from `first` in steps to before `end`. */
export const range = (first, end, step = 1) => Array.from({ length: Math.max(0, Math.ceil((end - first) / step)) }, (_, k) => first + k * step);
