// The way of each vehicle along its lane over time, coloured by speed.

import { readTheme } from "../theme.js";

const MARGIN = { left: 44, right: 10, top: 8, bottom: 22 }; // pixels, for the scales
const TICKS = 5;
const BREAK_MS = 500; // a longer silence is no line

/**
 * @typedef {import("./data.js").Lane} Lane
 * @typedef {import("./data.js").StateLine} StateLine
 * @typedef {{atMs: number, alongM: number, speedMps: number}} Sample
 */

/**
 * Return how far along a line of points the foot of a place lies.
 * @param {[number, number][]} points
 * @param {number} xM
 * @param {number} yM
 * @returns {number} metres from its start
 */
export function alongLine(points, xM, yM) {
  let [best, nearest, walked] = [0, Infinity, 0];
  for (let i = 1; i < points.length; i += 1) {
    const [[ax, ay], [bx, by]] = [points[i - 1], points[i]];
    const [dx, dy] = [bx - ax, by - ay];
    const lengthM = Math.hypot(dx, dy);
    const share = lengthM === 0 ? 0 : ((xM - ax) * dx + (yM - ay) * dy) / (lengthM * lengthM);
    const clipped = Math.min(Math.max(share, 0), 1);
    const distance = Math.hypot(xM - ax - clipped * dx, yM - ay - clipped * dy);
    if (distance < nearest) [best, nearest] = [walked + clipped * lengthM, distance];
    walked += lengthM;
  }
  return best;
}

/**
 * @param {StateLine[]} lines
 * @param {Lane | null} lane null: every vehicle, by its distance ahead of the radar
 * @returns {Map<string, Sample[]>} by track
 */
export function pathsOf(lines, lane) {
  /** @type {Map<string, Sample[]>} */
  const paths = new Map();
  for (const { timestamp, tracks } of lines) {
    const atMs = Date.parse(timestamp);
    for (const track of tracks) {
      if (lane !== null && track.lane !== lane.index) continue;
      const alongM = lane === null ? track.y_m : alongLine(lane.points_m, track.x_m, track.y_m);
      const path = paths.get(track.track_id) ?? [];
      path.push({ atMs, alongM, speedMps: Math.hypot(track.vx_mps, track.vy_mps) });
      paths.set(track.track_id, path);
    }
  }
  return paths;
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {Map<string, Sample[]>} paths
 * @param {{startMs: number, endMs: number}} window
 */
export function drawDiagram(canvas, paths, window) {
  const theme = readTheme();
  const ratio = devicePixelRatio || 1;
  const [widthPx, heightPx] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(widthPx * ratio);
  canvas.height = Math.round(heightPx * ratio);
  const pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, widthPx, heightPx);
  const samples = [...paths.values()].flat();
  const mostM = Math.max(10, ...samples.map(({ alongM }) => alongM));
  const left = (/** @type {number} */ atMs) =>
    MARGIN.left + ((atMs - window.startMs) / (window.endMs - window.startMs)) * (widthPx - MARGIN.left - MARGIN.right);
  const top = (/** @type {number} */ alongM) => heightPx - MARGIN.bottom - (alongM / mostM) * (heightPx - MARGIN.top - MARGIN.bottom);
  drawScales(pen, theme, { left, top, widthPx, heightPx, mostM, window });
  pen.lineWidth = 1.6;
  for (const path of paths.values()) {
    for (let i = 1; i < path.length; i += 1) {
      const [before, now] = [path[i - 1], path[i]];
      if (now.atMs - before.atMs > BREAK_MS) continue;
      pen.strokeStyle = theme.speed(now.speedMps);
      pen.beginPath();
      pen.moveTo(left(before.atMs), top(before.alongM));
      pen.lineTo(left(now.atMs), top(now.alongM));
      pen.stroke();
    }
  }
  canvas.dataset.tracks = String(paths.size);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("../theme.js").Theme} theme
 * @param {{left: (atMs: number) => number, top: (alongM: number) => number, widthPx: number, heightPx: number, mostM: number, window: {startMs: number, endMs: number}}} scales
 */
function drawScales(pen, theme, { left, top, widthPx, heightPx, mostM, window }) {
  pen.font = "11px system-ui, sans-serif";
  pen.fillStyle = theme.gridText;
  pen.strokeStyle = theme.grid;
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (let tick = 0; tick <= TICKS; tick += 1) {
    const alongM = (mostM * tick) / TICKS;
    pen.beginPath();
    pen.moveTo(MARGIN.left, top(alongM));
    pen.lineTo(widthPx - MARGIN.right, top(alongM));
    pen.stroke();
    pen.fillText(`${Math.round(alongM)} m`, MARGIN.left - 5, top(alongM));
  }
  pen.textAlign = "center";
  for (let tick = 0; tick <= TICKS; tick += 1) {
    const atMs = window.startMs + ((window.endMs - window.startMs) * tick) / TICKS;
    const inside = Math.min(Math.max(left(atMs), MARGIN.left + 20), widthPx - MARGIN.right - 24);
    pen.fillText(new Date(atMs).toLocaleTimeString([], { hour12: false }), inside, heightPx - MARGIN.bottom / 2);
  }
}
