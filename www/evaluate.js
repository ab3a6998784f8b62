/** Errors against known poses: statistics, curves, and the table as text. */
import { invertRigid } from "landline";
import { length } from "./panels.js";

/** Distance of the camera positions and angle between the rotations in degrees. */
export function poseError(estimated, known) {
  const e = invertRigid(estimated);
  const k = invertRigid(known);
  const distance = Math.hypot(e[3] - k[3], e[7] - k[7], e[11] - k[11]);
  // Rotation of one against the other; the angle from sine and cosine stays exact near zero.
  const d = (r, c) => [0, 1, 2].reduce((sum, i) => sum + estimated[4 * r + i] * known[4 * c + i], 0);
  const sine = 0.5 * Math.hypot(d(2, 1) - d(1, 2), d(0, 2) - d(2, 0), d(1, 0) - d(0, 1));
  const cosine = 0.5 * (d(0, 0) + d(1, 1) + d(2, 2) - 1);
  return { distance, degrees: (Math.atan2(sine, cosine) * 180) / Math.PI };
}

export function median(values) {
  if (values.length === 0) return NaN;
  const sorted = [...values].sort((a, b) => a - b);
  const middle = sorted.length >> 1;
  return sorted.length % 2 ? sorted[middle] : (sorted[middle - 1] + sorted[middle]) / 2;
}

/** Pairs of world length and degrees within which pictures are counted. */
const thresholds = [[0.02, 2], [0.05, 5], [0.1, 5]];

/** What is reported, distances in units of the world. Pictures that were not located count as infinitely wrong. */
export function summary(rows) {
  const known = rows.filter((row) => row.hasTruth);
  const recall = (distance, degrees) => known.filter((row) => row.located && row.distance <= distance && row.degrees <= degrees).length / Math.max(1, known.length);
  const finite = (key) => known.map((row) => (row.located ? row[key] : Infinity));
  return {
    pictures: rows.length,
    withTruth: known.length,
    located: rows.filter((row) => row.located).length,
    medianDistance: median(finite("distance")),
    medianDegrees: median(finite("degrees")),
    recalls: thresholds.map(([distance, degrees]) => ({ distance, degrees, share: recall(distance, degrees) })),
    medianMs: median(rows.map((row) => row.ms)),
  };
}

/** End of an axis: the round number (1, 2, 5, 10, …) that nine of ten values are below. */
export function axisEnd(values) {
  const sorted = [...values].sort((a, b) => a - b);
  const most = sorted[Math.ceil(0.9 * sorted.length) - 1];
  if (!(most > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(most));
  return power * ([1, 2, 5, 10].find((step) => step * power >= most) ?? 10);
}

/** Share of pictures below an error, for both errors; `metric` where the world is in metres. */
export function drawPlot(canvas, rows, metric) {
  const context = canvas.getContext("2d");
  const { width, height } = canvas;
  context.clearRect(0, 0, width, height);
  const known = rows.filter((row) => row.hasTruth);
  const pad = { left: 52, right: 14, top: 16, bottom: 34 };
  const w = width - pad.left - pad.right;
  const h = height - pad.top - pad.bottom;
  // Twice what a phone shows of it.
  context.font = "15px system-ui, sans-serif";
  context.fillStyle = "#9aa7b6";
  context.strokeStyle = "#28313c";
  for (let i = 0; i <= 4; i++) {
    const y = pad.top + h * (1 - i / 4);
    context.beginPath();
    context.moveTo(pad.left, y);
    context.lineTo(pad.left + w, y);
    context.stroke();
    context.fillText(`${25 * i} %`, 6, y + 4);
  }
  const located = known.filter((row) => row.located);
  const [farthest, widest] = ["distance", "degrees"].map((key) => axisEnd(located.map((row) => row[key])));
  const curve = (key, limit, color, dash) => {
    const values = located.map((row) => row[key]).sort((a, b) => a - b);
    context.beginPath();
    context.moveTo(pad.left, pad.top + h);
    values.forEach((value, i) => {
      const x = pad.left + w * Math.min(1, value / limit);
      context.lineTo(x, pad.top + h * (1 - i / Math.max(1, known.length)));
      context.lineTo(x, pad.top + h * (1 - (i + 1) / Math.max(1, known.length)));
    });
    context.strokeStyle = color;
    context.setLineDash(dash);
    context.lineWidth = 2;
    context.stroke();
    context.setLineDash([]);
    context.lineWidth = 1;
  };
  curve("distance", farthest, "#ffb057", []);
  curve("degrees", widest, "#62b6ff", [6, 4]);
  context.textAlign = "right";
  for (const i of [1, 2, 3, 4]) context.fillText(`${length((farthest * i) / 4, metric)} · ${Number(((widest * i) / 4).toPrecision(3))}°`, pad.left + (w * i) / 4, height - 10);
  context.fillStyle = "#ffb057";
  context.fillText("position (solid)", pad.left + w - 150, pad.top + h - 12);
  context.fillStyle = "#62b6ff";
  context.fillText("rotation (dashed)", pad.left + w, pad.top + h - 12);
  context.textAlign = "left";
}

export function toCsv(rows) {
  const head = "picture,located,position_error,rotation_error_deg,point_inliers,line_inliers,ms";
  const cell = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const body = rows.map((row) => [cell(row.name), row.located, row.located && row.hasTruth ? row.distance.toFixed(5) : "", row.located && row.hasTruth ? row.degrees.toFixed(4) : "", row.pointInliers, row.lineInliers, row.ms.toFixed(1)].join(","));
  return [head, ...body].join("\n") + "\n";
}
