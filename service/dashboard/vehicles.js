// Draw what moves: trails, raw points, and each track as a box with its uncertainty.

import { Trails } from "./trails.js";

const ELLIPSE_95 = Math.sqrt(5.991); // chi-square of two dimensions: the ellipse holds the truth in 95 of 100 cases
const LENGTH_USUAL_M = 4.5; // drawn while the extent is not known
const WIDTH_USUAL_M = 1.8;
const LENGTH_MIN_PX = 11; // else a vehicle is not seen on a phone
const WIDTH_MIN_PX = 5.5;
const NOSE = 0.3; // share of the length that the arrow at the front takes
const RING_GAP_PX = 6; // between a selected vehicle and the ring around it
const STILL_MPS = 0.5; // radial velocity below which a point may be scenery

/**
 * @typedef {object} Drawn
 * @property {import("./state.js").Track} track
 * @property {number} left
 * @property {number} top
 * @property {number} lengthPx
 * @property {number} widthPx
 * @property {number} headingRad
 * @property {number} ringPx distance of the ring around a selected vehicle, 0 for others
 */

/**
 * @param {import("./view.js").View} view
 * @param {import("./state.js").Track} track
 * @param {number} aheadS time for which it moves on at its speed
 * @param {boolean} selected
 * @returns {Drawn}
 */
export function placed(view, track, aheadS, selected) {
  const heading = track.heading_deg ?? (Math.atan2(track.vx_mps, track.vy_mps) * 180) / Math.PI;
  return {
    track,
    left: view.left(track.x_m + track.vx_mps * aheadS),
    top: view.top(track.y_m + track.vy_mps * aheadS),
    lengthPx: Math.max((track.length_m ?? LENGTH_USUAL_M) * view.scale, LENGTH_MIN_PX),
    widthPx: Math.max((track.width_m ?? WIDTH_USUAL_M) * view.scale, WIDTH_MIN_PX),
    headingRad: (heading * Math.PI) / 180,
    ringPx: selected ? RING_GAP_PX : 0,
  };
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {{id: string, way: import("./trails.js").Place[]}[]} trails
 * @param {Map<string, Drawn>} drawn where the tracks are now
 * @param {number} nowMs
 */
export function drawTrails(pen, view, theme, trails, drawn, nowMs) {
  pen.lineWidth = Math.min(Math.max(view.scale * 0.5, 1.5), 4);
  for (const { id, way } of trails) {
    for (let i = 1; i <= way.length; i += 1) {
      const from = way[i - 1];
      const to = way[i] ?? null;
      const head = drawn.get(id);
      if (to === null && head === undefined) break;
      pen.globalAlpha = 0.55 * Trails.freshness(from, nowMs) ** 1.5;
      pen.strokeStyle = theme.speed(from.speedMps);
      pen.beginPath();
      pen.moveTo(view.left(from.xM), view.top(from.yM));
      pen.lineTo(to ? view.left(to.xM) : head.left, to ? view.top(to.yM) : head.top);
      pen.stroke();
    }
  }
  pen.globalAlpha = 1;
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {NonNullable<import("./state.js").LiveView["points"]>} points
 * @returns {number} how many were drawn
 */
export function drawPoints(pen, view, theme, points) {
  const sizePx = Math.min(Math.max(view.scale * 0.35, 2), 5);
  for (let i = 0; i < points.x_m.length; i += 1) {
    const velocityMps = points.radial_velocity_mps[i];
    const still = velocityMps !== null && Math.abs(velocityMps) < STILL_MPS;
    pen.fillStyle = still ? theme.gridText : theme.point;
    pen.globalAlpha = still ? 0.6 : 0.95;
    pen.fillRect(view.left(points.x_m[i]) - sizePx / 2, view.top(points.y_m[i]) - sizePx / 2, sizePx, sizePx);
  }
  pen.globalAlpha = 1;
  return points.x_m.length;
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./view.js").View} view
 * @param {import("./theme.js").Theme} theme
 * @param {Drawn} drawn
 */
export function drawEllipse(pen, view, theme, { track, left, top }) {
  const varianceX = track.std_x_m ** 2;
  const varianceY = track.std_y_m ** 2;
  const middle = (varianceX + varianceY) / 2;
  const spread = Math.hypot((varianceX - varianceY) / 2, track.cov_xy_m2);
  const longPx = Math.sqrt(middle + spread) * ELLIPSE_95 * view.scale;
  const shortPx = Math.sqrt(Math.max(middle - spread, 0)) * ELLIPSE_95 * view.scale;
  const angle = Math.atan2(2 * track.cov_xy_m2, varianceX - varianceY) / 2; // from x, towards y
  pen.beginPath();
  pen.ellipse(left, top, longPx, shortPx, -angle, 0, 2 * Math.PI); // the canvas counts the other way round
  pen.globalAlpha = 0.16;
  pen.fillStyle = theme.ink;
  pen.fill();
  pen.globalAlpha = 0.45;
  pen.strokeStyle = theme.ink;
  pen.lineWidth = 1;
  pen.stroke();
  pen.globalAlpha = 1;
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./theme.js").Theme} theme
 * @param {Drawn} drawn
 */
export function drawBox(pen, theme, { track, left, top, lengthPx, widthPx, headingRad, ringPx }) {
  const colour = theme.speed(track.speed_mps);
  const [front, side] = [-lengthPx / 2, widthPx / 2];
  pen.save();
  pen.translate(left, top);
  pen.rotate(headingRad);
  pen.beginPath();
  pen.roundRect(-side, front, widthPx, lengthPx, Math.min(widthPx / 3, 5));
  if (track.status === "confirmed") {
    pen.fillStyle = colour;
    pen.fill();
    pen.strokeStyle = theme.halo;
    pen.lineWidth = 1;
    pen.stroke();
  } else {
    pen.globalAlpha = track.status === "tentative" ? 0.6 : 1;
    pen.fillStyle = theme.ground;
    pen.fill();
    pen.setLineDash([3, 2.5]);
    pen.strokeStyle = colour;
    pen.lineWidth = 1.5;
    pen.stroke();
    pen.setLineDash([]);
  }
  pen.beginPath(); // an arrow: the way it goes
  pen.moveTo(-side * 0.6, front + lengthPx * NOSE);
  pen.lineTo(0, front + lengthPx * NOSE * 0.35);
  pen.lineTo(side * 0.6, front + lengthPx * NOSE);
  pen.strokeStyle = track.status === "confirmed" ? theme.halo : colour;
  pen.lineWidth = 1.5;
  pen.stroke();
  if (ringPx > 0) {
    pen.beginPath();
    pen.roundRect(-side - ringPx, front - ringPx, widthPx + 2 * ringPx, lengthPx + 2 * ringPx, ringPx);
    pen.globalAlpha = 1;
    pen.strokeStyle = theme.mark;
    pen.lineWidth = 2;
    pen.stroke();
  }
  pen.restore();
}
