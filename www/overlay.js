/** What is drawn over the picture. Positions are in pixels of the frame; the canvas has the same shape. */

export const colors = {
  line: "#ffb057",
  point: "#62b6ff",
  segment: "#58e0c0",
  outlier: "#ff7a7a",
  axes: ["#ff6b6b", "#62d98b", "#7aa7ff"],
};

/** Nearer than this nothing is drawn; in units of the scene. */
const near = 0.05;

/** World point into camera space. `m` is row-major 4x4. */
function toCamera(m, x, y, z) {
  return [m[0] * x + m[1] * y + m[2] * z + m[3], m[4] * x + m[5] * y + m[6] * z + m[7], m[8] * x + m[9] * y + m[10] * z + m[11]];
}

function toPixel(k, p) {
  return [(k.fx * p[0]) / p[2] + k.cx, (k.fy * p[1]) / p[2] + k.cy];
}

/** Projects a world segment; the part behind the camera is cut off. `null` when nothing is left. */
export function projectSegment(m, k, ax, ay, az, bx, by, bz) {
  let a = toCamera(m, ax, ay, az);
  let b = toCamera(m, bx, by, bz);
  if (a[2] < near && b[2] < near) return null;
  if (a[2] < near) a = cut(a, b);
  else if (b[2] < near) b = cut(b, a);
  return [...toPixel(k, a), ...toPixel(k, b)];
}

function cut(behind, before) {
  const t = (near - behind[2]) / (before[2] - behind[2]);
  return behind.map((v, i) => v + t * (before[i] - v));
}

/** Draws the chosen layers of one result. `map` may be null. */
export function drawOverlay(canvas, result, map, layers, opacity) {
  const { width, height } = result.frame;
  const context = canvas.getContext("2d");
  // Thin lines need the pixels of the screen, not those of a small frame.
  const scale = Math.max(1, Math.min(4, (canvas.clientWidth * devicePixelRatio) / width));
  const w = Math.round(width * scale);
  const h = Math.round(height * scale);
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  const unit = Math.max(width, height) / 640;
  context.lineCap = "round";
  context.globalAlpha = opacity;
  const { placement, intrinsics } = result;
  if (layers.segments && result.segments) strokeAll(context, segmentPaths(result.segments), colors.segment, 1.1 * unit);
  if (placement && layers.mapLines && map) {
    context.globalAlpha = opacity * 0.5;
    strokeAll(context, mapPaths(map, placement.cameraFromWorld, intrinsics), colors.line, 1.3 * unit);
    context.globalAlpha = opacity;
  }
  if (placement && result.lines && (layers.lines || layers.outliers)) frameLines(context, result, layers, unit);
  if (result.points && (layers.points || layers.outliers)) framePoints(context, result, layers, unit);
  if (placement && layers.axes) axes(context, placement.cameraFromWorld, intrinsics, unit);
  context.globalAlpha = 1;
}

/** Leaves nothing over the picture. */
export function clearOverlay(canvas) {
  canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
}

function* segmentPaths(segments) {
  for (let i = 0; i + 3 < segments.length; i += 4) yield segments.subarray(i, i + 4);
}

function* mapPaths(map, m, k) {
  for (const line of map.lines()) {
    const path = projectSegment(m, k, ...line);
    if (path) yield path;
  }
}

function strokeAll(context, paths, color, lineWidth, dash = []) {
  context.beginPath();
  for (const [x1, y1, x2, y2] of paths) {
    context.moveTo(x1, y1);
    context.lineTo(x2, y2);
  }
  context.setLineDash(dash);
  context.strokeStyle = color;
  context.lineWidth = lineWidth;
  context.stroke();
  context.setLineDash([]);
}

function frameLines(context, result, layers, unit) {
  const inliers = [];
  const outliers = [];
  const { world, pixels, isInlier } = result.lines;
  for (let i = 0; i < isInlier.length; i++) {
    if (isInlier[i]) {
      const path = projectSegment(result.placement.cameraFromWorld, result.intrinsics, ...world.subarray(6 * i, 6 * i + 6));
      if (path) inliers.push(path);
    } else {
      outliers.push(pixels.subarray(4 * i, 4 * i + 4));
    }
  }
  if (layers.outliers) strokeAll(context, outliers, colors.outlier, 1.3 * unit, [5 * unit, 4 * unit]);
  if (layers.lines) {
    strokeAll(context, inliers, "#0008", 4.2 * unit);
    strokeAll(context, inliers, colors.line, 2.3 * unit);
  }
}

function framePoints(context, result, layers, unit) {
  const { pixels, isInlier } = result.points;
  const radius = 2.1 * unit;
  if (layers.points) {
    context.beginPath();
    for (let i = 0; i < isInlier.length; i++) {
      if (!isInlier[i]) continue;
      context.moveTo(pixels[2 * i] + radius, pixels[2 * i + 1]);
      context.arc(pixels[2 * i], pixels[2 * i + 1], radius, 0, 2 * Math.PI);
    }
    context.fillStyle = colors.point;
    context.strokeStyle = "#0009";
    context.lineWidth = 0.7 * unit;
    context.fill();
    context.stroke();
  }
  if (layers.outliers) {
    const crosses = [];
    const r = 2.4 * unit;
    for (let i = 0; i < isInlier.length; i++) {
      if (isInlier[i]) continue;
      const [x, y] = [pixels[2 * i], pixels[2 * i + 1]];
      crosses.push([x - r, y - r, x + r, y + r], [x - r, y + r, x + r, y - r]);
    }
    strokeAll(context, crosses, colors.outlier, unit);
  }
}

function axes(context, m, k, unit) {
  const ends = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  ends.forEach((end, i) => {
    const path = projectSegment(m, k, 0, 0, 0, ...end);
    if (!path) return;
    strokeAll(context, [path], colors.axes[i], 3 * unit);
    context.fillStyle = colors.axes[i];
    context.font = `${12 * unit}px ui-monospace, monospace`;
    context.fillText("xyz"[i], path[2] + 4 * unit, path[3]);
  });
}
