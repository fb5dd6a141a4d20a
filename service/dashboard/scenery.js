// Draw what does not move: the sensor's region, range rings, azimuth limits and count lines.

const RING_STEPS_M = [5, 10, 25, 50, 100, 200];
const RING_GAP_PX = 70; // rings closer than this would be a crowd
const DEGREE = Math.PI / 180;
const EDGE_PX = 26; // room for a ring's label at the edge of the canvas
const NAME_GAP_PX = 6; // between a count line and its name
const TEXT_PX = 14; // height of a line of text
const FONT = "11px system-ui, sans-serif";

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {import("./state.js").Sensor | null} sensor
 * @returns {import("./labels.js").Rect[]} where names of count lines stand
 */
export function drawScenery(pen, view, theme, sensor) {
  pen.fillStyle = theme.ground;
  pen.fillRect(0, 0, view.widthPx, view.heightPx);
  if (sensor === null) return [];
  drawRegion(pen, view, theme, sensor.region);
  drawRings(pen, view, theme, sensor.region);
  drawRadar(pen, view, theme);
  return sensor.count_lines.map((line) => drawCountLine(pen, view, theme, line));
}

/**
 * @param {import("./state.js").Sensor["region"]} region
 * @returns {[number, number]} the canvas angles of its two sides; straight ahead is -90 degrees there
 */
function sides(region) {
  const halfRad = region.azimuth_max_deg * DEGREE;
  return [-Math.PI / 2 - halfRad, -Math.PI / 2 + halfRad];
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {import("./state.js").Sensor["region"]} region
 */
function drawRegion(pen, view, theme, region) {
  const [leftRad, rightRad] = sides(region);
  const [originLeft, originTop] = [view.left(0), view.top(0)];
  pen.beginPath();
  pen.arc(originLeft, originTop, region.range_max_m * view.scale, leftRad, rightRad);
  pen.arc(originLeft, originTop, region.range_min_m * view.scale, rightRad, leftRad, true);
  pen.closePath();
  pen.fillStyle = theme.region;
  pen.fill();
  pen.strokeStyle = theme.line;
  pen.lineWidth = 1;
  pen.stroke();
  pen.setLineDash([2, 6]);
  pen.beginPath();
  pen.moveTo(originLeft, view.top(region.range_min_m));
  pen.lineTo(originLeft, view.top(region.range_max_m));
  pen.strokeStyle = theme.grid;
  pen.stroke();
  pen.setLineDash([]);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {import("./state.js").Sensor["region"]} region
 */
function drawRings(pen, view, theme, region) {
  const stepM = RING_STEPS_M.find((step) => step * view.scale >= RING_GAP_PX) ?? RING_STEPS_M.at(-1);
  const [leftRad, rightRad] = sides(region);
  pen.font = FONT;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.lineWidth = 1;
  for (let rangeM = stepM; rangeM < region.range_max_m + stepM; rangeM += stepM) {
    const ringM = Math.min(rangeM, region.range_max_m);
    const radiusPx = ringM * view.scale;
    pen.beginPath();
    pen.arc(view.left(0), view.top(0), radiusPx, leftRad, rightRad);
    pen.strokeStyle = theme.grid;
    pen.stroke();
    drawRingLabel(pen, view, theme, ringM, rightRad);
  }
}

/**
 * Write a ring's range where it leaves the region, or the canvas.
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {number} ringM
 * @param {number} rightRad
 */
function drawRingLabel(pen, view, theme, ringM, rightRad) {
  const radiusPx = ringM * view.scale;
  const roomPx = view.widthPx - EDGE_PX - view.left(0);
  const atEdgeRad = roomPx < radiusPx ? Math.asin(Math.max(roomPx, 0) / radiusPx) - Math.PI / 2 : rightRad;
  const angle = Math.min(rightRad, atEdgeRad);
  const left = view.left(0) + radiusPx * Math.cos(angle);
  const top = view.top(0) + radiusPx * Math.sin(angle);
  const text = `${Math.round(ringM)} m`;
  const widthPx = pen.measureText(text).width;
  pen.fillStyle = theme.ground;
  pen.beginPath();
  pen.roundRect(left - widthPx / 2 - 4, top - 8, widthPx + 8, 16, 4);
  pen.fill();
  pen.fillStyle = theme.gridText;
  pen.fillText(text, left, top);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {import("./state.js").Sensor["count_lines"][number]} line
 * @returns {import("./labels.js").Rect} where its name stands
 */
function drawCountLine(pen, view, theme, line) {
  const [[x0M, y0M], [x1M, y1M]] = [line.p0, line.p1];
  pen.strokeStyle = theme.mark;
  pen.lineWidth = 1.5;
  pen.setLineDash([6, 4]);
  pen.beginPath();
  pen.moveTo(view.left(x0M), view.top(y0M));
  pen.lineTo(view.left(x1M), view.top(y1M));
  pen.stroke();
  pen.setLineDash([]);
  pen.font = FONT;
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  pen.fillStyle = theme.mark;
  const [xM, yM] = x1M >= x0M ? line.p1 : line.p0;
  const [left, top] = [view.left(xM) + NAME_GAP_PX, view.top(yM)];
  pen.fillText(line.line_id, left, top);
  return { left, top: top - TEXT_PX / 2, right: left + pen.measureText(line.line_id).width, bottom: top + TEXT_PX / 2 };
}

/**
 * Draw the count line that is being made: its ends as far as they are set, and what lies between.
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {[number, number][]} ends
 */
export function drawDraft(pen, view, theme, ends) {
  pen.strokeStyle = theme.mark;
  pen.fillStyle = theme.mark;
  pen.lineWidth = 2.5;
  pen.beginPath();
  for (const [xM, yM] of ends) pen.lineTo(view.left(xM), view.top(yM));
  pen.stroke();
  for (const [xM, yM] of ends) {
    pen.beginPath();
    pen.arc(view.left(xM), view.top(yM), 5, 0, 2 * Math.PI);
    pen.fill();
  }
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 */
function drawRadar(pen, view, theme) {
  const [left, top] = [view.left(0), view.top(0)];
  pen.fillStyle = theme.gridText;
  pen.beginPath();
  pen.arc(left, top, 3.5, 0, 2 * Math.PI);
  pen.fill();
  pen.strokeStyle = theme.gridText;
  pen.lineWidth = 1.5;
  for (const radiusPx of [8, 12.5]) {
    pen.beginPath();
    pen.arc(left, top, radiusPx, -Math.PI / 2 - 0.7, -Math.PI / 2 + 0.7);
    pen.stroke();
  }
}
