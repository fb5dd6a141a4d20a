// Write speed and number beside each vehicle, without writing over another one.

import { shortId, speedNumber } from "./format.js";

const FONT_SPEED = "600 12px system-ui, sans-serif";
const FONT_NUMBER = "11px system-ui, sans-serif";
const HEIGHT_PX = 15;
const GAP_PX = 5; // between box and label, and between speed and number
const HALO_PX = 3;

/** @typedef {{left: number, top: number, right: number, bottom: number}} Rect */
/** @typedef {import("./vehicles.js").Drawn} Drawn */

/** Remembers the side on which each label stood, so that labels do not jump. */
export class Labels {
  /** @type {Map<string, number>} */
  #sides = new Map();

  /**
   * @param {CanvasRenderingContext2D} pen
   * @param {import("./theme.js").Theme} theme
   * @param {Drawn[]} vehicles
   * @param {import("./format.js").Unit} unit
   * @param {Rect[]} obstacles other things that are written there
   * @returns {number} how many labels found a place
   */
  draw(pen, theme, vehicles, unit, obstacles) {
    const taken = [...obstacles, ...vehicles.map(outline)];
    const middlePx = vehicles.reduce((sum, vehicle) => sum + vehicle.left, 0) / Math.max(vehicles.length, 1);
    const sides = new Map();
    pen.textBaseline = "middle";
    pen.textAlign = "left";
    pen.lineJoin = "round";
    const first = [...vehicles].sort((a, b) => b.ringPx - a.ringPx); // the selected one chooses its place
    for (const vehicle of first) {
      const label = measured(pen, vehicle, unit);
      const side = this.#side(vehicle, label.widthPx, taken, middlePx, vehicle.ringPx > 0);
      if (side === null) continue;
      const rect = rectAt(vehicle, label.widthPx, side);
      taken.push(rect);
      sides.set(vehicle.track.track_id, side);
      write(pen, theme, label, rect);
    }
    this.#sides = sides;
    return sides.size;
  }

  /**
   * @param {Drawn} vehicle
   * @param {number} widthPx
   * @param {Rect[]} taken
   * @param {number} middlePx labels stand on the outer side of the road where they can
   * @param {boolean} must
   * @returns {number | null}
   */
  #side(vehicle, widthPx, taken, middlePx, must) {
    const outward = vehicle.left < middlePx ? [1, 0, 3, 2, 5, 4] : [0, 1, 2, 3, 4, 5];
    const last = this.#sides.get(vehicle.track.track_id);
    const order = last === undefined ? outward : [last, ...outward];
    const free = order.find((side) => {
      const rect = rectAt(vehicle, widthPx, side);
      return !taken.some((other) => overlap(rect, other));
    });
    return free ?? (must ? outward[0] : null);
  }
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {Drawn} vehicle
 * @param {import("./format.js").Unit} unit
 */
function measured(pen, { track }, unit) {
  const speed = speedNumber(track.speed_mps, unit);
  const number = `#${shortId(track.track_id)}`;
  pen.font = FONT_SPEED;
  const speedPx = pen.measureText(speed).width;
  pen.font = FONT_NUMBER;
  return { speed, number, speedPx, widthPx: speedPx + GAP_PX + pen.measureText(number).width };
}

/**
 * @param {CanvasRenderingContext2D} pen
 * @param {import("./theme.js").Theme} theme
 * @param {{speed: string, number: string, speedPx: number}} label
 * @param {Rect} rect
 */
function write(pen, theme, label, rect) {
  const middle = (rect.top + rect.bottom) / 2;
  pen.strokeStyle = theme.ground;
  pen.lineWidth = HALO_PX;
  pen.font = FONT_SPEED;
  pen.strokeText(label.speed, rect.left, middle);
  pen.fillStyle = theme.ink;
  pen.fillText(label.speed, rect.left, middle);
  pen.font = FONT_NUMBER;
  pen.strokeText(label.number, rect.left + label.speedPx + GAP_PX, middle);
  pen.fillStyle = theme.gridText;
  pen.fillText(label.number, rect.left + label.speedPx + GAP_PX, middle);
}

/**
 * @param {Drawn} vehicle
 * @param {number} widthPx
 * @param {number} side 0 right, 1 left, then the same above, then below
 * @returns {Rect}
 */
function rectAt(vehicle, widthPx, side) {
  const box = outline(vehicle);
  const left = side % 2 === 0 ? box.right + GAP_PX : box.left - GAP_PX - widthPx;
  const shiftPx = [0, -HEIGHT_PX, HEIGHT_PX][Math.floor(side / 2)];
  const top = vehicle.top - HEIGHT_PX / 2 + shiftPx;
  return { left, top, right: left + widthPx, bottom: top + HEIGHT_PX };
}

/**
 * @param {Drawn} vehicle
 * @returns {Rect} around the turned box, or the ring
 */
function outline({ left, top, lengthPx, widthPx, headingRad, ringPx }) {
  const [sine, cosine] = [Math.abs(Math.sin(headingRad)), Math.abs(Math.cos(headingRad))];
  const acrossPx = (widthPx * cosine + lengthPx * sine) / 2 + ringPx;
  const alongPx = (lengthPx * cosine + widthPx * sine) / 2 + ringPx;
  return { left: left - acrossPx, top: top - alongPx, right: left + acrossPx, bottom: top + alongPx };
}

/**
 * @param {Rect} a
 * @param {Rect} b
 */
function overlap(a, b) {
  return a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
}
