// Fetch the lane map of the sensor that is shown, and draw it under everything that moves.

import { Problem, request } from "./api.js";

const PERIOD_MS = 10_000;
const FONT = "11px system-ui, sans-serif";
const ARROW_GAP_PX = 90;
const ARROW_PX = 4.5;

/**
 * @typedef {object} Lane
 * @property {string} lane_id
 * @property {string | null} name
 * @property {"lane" | "turn"} kind
 * @property {[number, number][]} points_m
 * @property {[number, number][]} left_m
 * @property {[number, number][]} right_m
 */

/** Keeps `store.state.lanes` fresh. */
export class LaneMap {
  /** @type {string | null} */
  #etag = null;
  /** @type {string | null} */
  #sensorId = null;
  #askedAtMs = -Infinity;

  /** @param {import("./state.js").Store} store */
  constructor(store) {
    this.store = store;
    store.subscribe(() => this.#refresh());
    setInterval(() => this.#refresh(), PERIOD_MS);
  }

  async #refresh() {
    const { sensorId } = this.store.state;
    const nowMs = performance.now();
    const changed = sensorId !== this.#sensorId;
    if (!changed && (document.hidden || nowMs - this.#askedAtMs < PERIOD_MS)) return;
    [this.#sensorId, this.#askedAtMs] = [sensorId, nowMs];
    if (changed) {
      this.#etag = null;
      this.store.set({ lanes: [] });
    }
    if (sensorId === null) return;
    try {
      const headers = this.#etag ? { "If-None-Match": this.#etag } : {};
      const response = await request(`api/v1/sensors/${encodeURIComponent(sensorId)}/lanes`, { headers });
      if (response.status === 304 || sensorId !== this.#sensorId) return;
      this.#etag = response.headers.get("ETag");
      this.store.set({ lanes: (await response.json()).lanes });
    } catch (error) {
      // The live poll tells of a server that is gone or a session that has ended; the old map stays meanwhile.
      if (!(error instanceof Problem || error instanceof TypeError || error instanceof DOMException)) throw error;
    }
  }
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {Lane[]} lanes
 */
export function drawLanes(pen, view, theme, lanes) {
  pen.lineWidth = 1;
  for (const lane of lanes) {
    if (lane.kind === "lane") {
      for (const side of [lane.left_m, lane.right_m]) trace(pen, view, side, theme.line, []);
    } else {
      trace(pen, view, lane.points_m, theme.line, [2, 4]);
    }
    drawArrows(pen, view, theme, lane.points_m);
  }
  pen.setLineDash([]);
  for (const lane of lanes) if (lane.kind === "lane") drawName(pen, view, theme, lane);
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {[number, number][]} points
 * @param {string} colour
 * @param {number[]} dash
 */
function trace(pen, view, points, colour, dash) {
  pen.strokeStyle = colour;
  pen.setLineDash(dash);
  pen.beginPath();
  for (const [xM, yM] of points) pen.lineTo(view.left(xM), view.top(yM));
  pen.stroke();
}

/**
 * Small arrows along the centre line, in driving direction.
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {[number, number][]} points
 */
function drawArrows(pen, view, theme, points) {
  pen.setLineDash([]);
  pen.strokeStyle = theme.gridText;
  let walkedPx = ARROW_GAP_PX / 2;
  for (let i = 1; i < points.length; i += 1) {
    const [fromPx, fromTop] = [view.left(points[i - 1][0]), view.top(points[i - 1][1])];
    const [toPx, toTop] = [view.left(points[i][0]), view.top(points[i][1])];
    walkedPx += Math.hypot(toPx - fromPx, toTop - fromTop);
    if (walkedPx < ARROW_GAP_PX) continue;
    walkedPx = 0;
    const angle = Math.atan2(toTop - fromTop, toPx - fromPx);
    pen.beginPath();
    for (const turn of [Math.PI - 0.5, 0, Math.PI + 0.5]) {
      const reach = turn === 0 ? 0 : ARROW_PX;
      pen.lineTo(toPx + reach * Math.cos(angle + turn), toTop + reach * Math.sin(angle + turn));
    }
    pen.stroke();
  }
}

/**
 * Write the lane's name where it ends nearest to the radar.
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {Lane} lane
 */
function drawName(pen, view, theme, lane) {
  const [first, last] = [lane.points_m[0], /** @type {[number, number]} */ (lane.points_m.at(-1))];
  const [xM, yM] = Math.hypot(...first) < Math.hypot(...last) ? first : last;
  pen.font = FONT;
  pen.textAlign = "center";
  pen.textBaseline = "top";
  pen.fillStyle = theme.gridText;
  pen.fillText(lane.name ?? lane.lane_id, view.left(xM), view.top(yM) + 4);
}
