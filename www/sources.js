/** Where pictures come from. A playlist is a list of `{ name, blob(), thumb?, truth?, intrinsics? }`. */
import { parsePoses } from "./evaluate.js";

const isImage = (file) => file.type.startsWith("image/") || /\.(png|jpe?g|webp|avif|bmp)$/i.test(file.name);
const isVideo = (file) => file.type.startsWith("video/") || /\.(mp4|webm|mov|mkv|m4v|y4m)$/i.test(file.name);
const isScene = (file) => /\.(landline|safetensors)$/i.test(file.name);
const isPoses = (file) => /pose[^/]*\.txt$/i.test(file.name) || /\.poses$/i.test(file.name);

/** The pictures that come with the page, with their true poses. */
export async function samplePlaylist(base) {
  const response = await fetch(new URL("sample.json", base));
  if (!response.ok) throw Object.assign(new Error(`the list of sample pictures is not there (${response.status})`), { code: "asset-fetch", hint: "Use your camera or a picture instead." });
  const { camera, pictures } = await response.json();
  return pictures.map((picture) => {
    const url = new URL(picture.name, base).href;
    return {
      name: picture.name,
      thumb: url,
      intrinsics: picture.camera ?? camera,
      truth: Float64Array.from(picture.cam_from_world.flat()),
      blob: async () => {
        const answer = await fetch(url);
        if (!answer.ok) throw Object.assign(new Error(`${picture.name} could not be loaded (${answer.status})`), { code: "asset-fetch", hint: "Check the connection." });
        return answer.blob();
      },
    };
  });
}

/** Sorts dropped or chosen files into what they are. */
export async function sortFiles(files) {
  const byName = (a, b) => a.name.localeCompare(b.name, "en", { numeric: true });
  const images = files.filter(isImage).sort(byName);
  const poseFile = files.filter(isPoses).sort(byName)[0];
  const known = poseFile ? parsePoses(await poseFile.text()) : { poses: [], skipped: 0 };
  const truth = new Map(known.poses.map((pose) => [pose.name, pose]));
  // Thumbnails of hundreds of large pictures would take more memory than the engine.
  const withThumbs = images.length <= 60;
  return {
    scene: files.find(isScene),
    video: files.find(isVideo),
    poseFile: poseFile?.name,
    skippedLines: known.skipped,
    numTruth: images.filter((file) => truth.has(file.name)).length,
    pictures: images.map((file) => {
      const pose = truth.get(file.name);
      return {
        name: file.name,
        thumb: withThumbs ? URL.createObjectURL(file) : undefined,
        blob: async () => file,
        ...(pose ? { truth: pose.cameraFromWorld } : {}),
        ...(pose?.focal ? { focal: pose.focal } : {}),
      };
    }),
  };
}

/** Frees what `sortFiles` made. */
export function releasePlaylist(playlist) {
  for (const { thumb } of playlist) if (thumb?.startsWith("blob:")) URL.revokeObjectURL(thumb);
}
