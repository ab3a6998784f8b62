/** A mapper that has seen what the film holds: pictures of an earlier visit, or of a mapper that broke, are given to it again. */

/** Answers with the mapper. `tell` hears of downloads and of pictures that are read again. */
export async function feed(flow, tell, signal) {
  const mapper = await flow.mapper(tell);
  const { film } = flow;
  if (flow.isFed() || film.pictures.length === 0) return mapper;
  await mapper.clear();
  const keyframes = [];
  for (const [i, { blob, timestamp, name }] of film.pictures.entries()) {
    signal?.throwIfAborted();
    tell({ status: "again", done: i + 1, total: film.pictures.length });
    const verdict = await mapper.addFrame(blob, { timestamp, name, keep: true });
    keyframes.push(verdict.kept ? verdict.keyframe : undefined);
  }
  film.renumber(keyframes);
  return mapper;
}
