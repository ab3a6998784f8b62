/** The panel with errors against known poses. */
import { $ } from "./dom.js";
import { drawPlot, summary } from "./evaluate.js";
import { facts, length, ms } from "./panels.js";

/** One line of the table. */
export function addRow(row, metric) {
  const cells = [
    row.name,
    row.located ? (row.hasTruth ? length(row.distance, metric) : "–") : (row.failed ?? "not located"),
    row.located && row.hasTruth ? `${row.degrees.toFixed(2)}°` : "–",
    `${row.pointInliers} + ${row.lineInliers}`,
    row.ms ? row.ms.toFixed(0) : "–",
  ];
  const tr = $("evaluation-table").tBodies[0].insertRow();
  cells.forEach((text) => (tr.insertCell().textContent = text));
}

/** Numbers and curves over all rows. */
export function showSummary(all, metric) {
  const s = summary(all);
  const percent = (v) => `${(100 * v).toFixed(1)} %`;
  const rows = [["Pictures", `${s.pictures}, ${s.located} located`]];
  if (s.withTruth > 0) {
    const finite = (value, text) => (Number.isFinite(value) ? text : "over half not located");
    rows.push(
      ["Median error", finite(s.medianDistance, `${length(s.medianDistance, metric)}, ${s.medianDegrees.toFixed(2)}°`)],
      ...s.recalls.map(({ distance, degrees, share }) => [`Within ${metric ? `${100 * distance} cm` : `${distance} units`}, ${degrees}°`, percent(share)]),
    );
  }
  rows.push(["Median time", ms(s.medianMs)]);
  facts($("evaluation-facts"), rows);
  // Without known positions there are no errors to draw.
  $("evaluation-plot").hidden = s.withTruth === 0;
  drawPlot($("evaluation-plot"), all, metric);
}

/** Offers a text as a file. */
export function save(name, text, type) {
  const url = URL.createObjectURL(new Blob([text], { type }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}
