// The colours of the canvas, read from the style sheet, so that both follow one scheme.

const NAMES = ["ground", "region", "grid", "grid-text", "line", "ink", "halo", "point", "mark", "slow", "medium", "fast"];

/** Speeds at which the colour is slow, medium and fast; between them it is mixed. */
export const SPEED_STOPS_MPS = [0, 30 / 3.6, 60 / 3.6];

const SHADES = 24; // steps of the speed scale, made once for each scheme

/**
 * @typedef {object} Theme
 * @property {string} ground
 * @property {string} region
 * @property {string} grid
 * @property {string} gridText
 * @property {string} line
 * @property {string} ink
 * @property {string} halo
 * @property {string} point
 * @property {string} mark
 * @property {(speedMps: number) => string} speed
 */

/** @returns {Theme} */
export function readTheme() {
  const style = getComputedStyle(document.documentElement);
  const colours = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--plan-${name}`).trim()]));
  const stops = [colours.slow, colours.medium, colours.fast].map(components);
  const shades = Array.from({ length: SHADES + 1 }, (_, step) => mixed(stops, (step / SHADES) * 2));
  return {
    ground: colours.ground,
    region: colours.region,
    grid: colours.grid,
    gridText: colours["grid-text"],
    line: colours.line,
    ink: colours.ink,
    halo: colours.halo,
    point: colours.point,
    mark: colours.mark,
    speed: (speedMps) => shades[Math.round((speedPlace(speedMps) / 2) * SHADES)],
  };
}

/**
 * @param {number} speedMps
 * @returns {number} 0 at the first stop, 1 at the second, 2 at the third and beyond
 */
function speedPlace(speedMps) {
  const [slow, medium, fast] = SPEED_STOPS_MPS;
  const place =
    speedMps < medium ? (speedMps - slow) / (medium - slow) : 1 + (speedMps - medium) / (fast - medium);
  return Math.min(Math.max(place, 0), 2);
}

/**
 * @param {number[][]} stops
 * @param {number} place
 */
function mixed(stops, place) {
  const first = Math.min(Math.floor(place), stops.length - 2);
  const share = place - first;
  const parts = stops[first].map((value, i) => Math.round(value + (stops[first + 1][i] - value) * share));
  return `rgb(${parts.join(" ")})`;
}

/** @param {string} hex such as "#43c0a8" */
function components(hex) {
  return [1, 3, 5].map((start) => Number.parseInt(hex.slice(start, start + 2), 16));
}
