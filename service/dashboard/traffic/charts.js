// Time series of a measure, a line for each lane.

import uPlot from "../vendor/uplot/uPlot.esm.js";

const HEIGHT_PX = 240;
const LANE_COLOURS = 8;
const NO_LANE = "no lane";

/** @typedef {import("./data.js").FlowRow} FlowRow */

/**
 * @param {FlowRow} row
 * @returns {string} names the lane in a direction
 */
export function laneKey(row) {
  const way = row.direction === null ? "" : row.direction > 0 ? " ←" : " →";
  return `${row.lane_id ?? NO_LANE}${way}`;
}

/**
 * @param {number} place of the lane in the order of lanes
 * @returns {string} its colour in the scheme of now
 */
export function laneColour(place) {
  const name = `--lane-${(place % LANE_COLOURS) + 1}`;
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/**
 * Return the columns of a chart: times [s], then a column for each lane, null where nothing is known.
 * @param {FlowRow[]} rows
 * @param {string[]} lanes
 * @param {(row: FlowRow) => number | null} valueOf
 * @returns {(number | null)[][]}
 */
export function columnsOf(rows, lanes, valueOf) {
  const starts = [...new Set(rows.map((row) => row.start))].sort();
  const place = new Map(starts.map((start, i) => [start, i]));
  const columns = lanes.map(() => /** @type {(number | null)[]} */ (starts.map(() => null)));
  for (const row of rows) {
    const lane = lanes.indexOf(laneKey(row));
    if (lane >= 0) columns[lane][/** @type {number} */ (place.get(row.start))] = valueOf(row);
  }
  return [starts.map((start) => Date.parse(start) / 1000), ...columns];
}

/**
 * @param {string[]} keys of `laneKey`
 * @returns {string[]} in the order of lanes, vehicles without one last
 */
export function inOrder(keys) {
  const laneless = (/** @type {string} */ key) => Number(key.startsWith(NO_LANE));
  return keys.sort((a, b) => laneless(a) - laneless(b) || a.localeCompare(b, undefined, { numeric: true }));
}

/** @param {number} atS seconds since 1970 */
function clockText(atS) {
  const at = new Date(atS * 1000);
  const midnight = at.getHours() === 0 && at.getMinutes() === 0;
  return midnight
    ? at.toLocaleDateString([], { day: "numeric", month: "short" })
    : at.toLocaleTimeString([], { hour: "2-digit", minute: "2-digit", hour12: false });
}

/** One chart; a click tells which interval was meant. */
export class Chart {
  /** @type {uPlot | null} */
  #plot = null;
  #key = "";

  /**
   * @param {HTMLElement} place
   * @param {(startMs: number) => void} onPick
   */
  constructor(place, onPick) {
    this.place = place;
    this.onPick = onPick;
    new ResizeObserver(() => this.#plot?.setSize({ width: this.#widthPx, height: HEIGHT_PX })).observe(place);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.#key = "";
    });
  }

  get #widthPx() {
    return Math.max(this.place.clientWidth - 16, 200);
  }

  /**
   * @param {(number | null)[][]} columns
   * @param {string[]} lanes
   * @param {{startMs: number, endMs: number}} window
   * @param {boolean} stepped
   */
  show(columns, lanes, window, stepped) {
    this.place.dataset.points = String(columns[0].length);
    this.place.dataset.lanes = lanes.join(",");
    const key = JSON.stringify([lanes, stepped, laneColour(0)]);
    const range = { min: window.startMs / 1000, max: window.endMs / 1000 };
    if (this.#plot === null || key !== this.#key) {
      this.#key = key;
      this.#plot?.destroy();
      this.#plot = new uPlot(this.#options(lanes, stepped), columns, this.place);
      this.#plot.over.addEventListener("click", () => {
        const at = this.#plot?.cursor.idx;
        if (at != null && this.#plot) this.onPick(this.#plot.data[0][at] * 1000);
      });
    } else {
      this.#plot.setData(columns, false);
    }
    this.#plot.setScale("x", range);
  }

  /**
   * @param {string[]} lanes
   * @param {boolean} stepped
   */
  #options(lanes, stepped) {
    const style = getComputedStyle(document.documentElement);
    const [text, grid] = ["--quiet", "--edge"].map((name) => style.getPropertyValue(name).trim());
    const axis = { stroke: text, grid: { stroke: grid, width: 1 }, ticks: { stroke: grid } };
    const paths = stepped ? uPlot.paths.stepped({ align: 1 }) : uPlot.paths.linear();
    return {
      width: this.#widthPx,
      height: HEIGHT_PX,
      scales: { x: { time: true, auto: false }, y: { range: (/** @type {uPlot} */ _, /** @type {number} */ __, /** @type {number} */ most) => [0, Math.max(most * 1.1, 1)] } },
      axes: [{ ...axis, values: (/** @type {uPlot} */ _, /** @type {number[]} */ splits) => splits.map(clockText) }, axis],
      series: [
        { label: "from", value: "{YYYY}-{MM}-{DD} {HH}:{mm}" }, // of the interval under the pointer
        ...lanes.map((lane, place) => ({
          label: lane,
          stroke: laneColour(place),
          width: 2,
          paths,
          spanGaps: false,
          points: { show: true, size: 5, fill: laneColour(place) },
          value: (/** @type {uPlot} */ _, /** @type {number | null} */ value) => (value == null ? "–" : value.toFixed(value < 100 ? 1 : 0)),
        })),
      ],
    };
  }
}
