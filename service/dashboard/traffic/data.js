// What the page of traffic asks of the server.

import { readJson, request } from "../api.js";

/**
 * @typedef {object} FlowRow
 * @property {string} row
 * @property {string} line_id
 * @property {string | null} lane_id
 * @property {-1 | 1 | null} direction
 * @property {string} start
 * @property {string} end
 * @property {number} coverage
 * @property {number} n
 * @property {number} volume
 * @property {number} volume_low
 * @property {number} volume_high
 * @property {number} flow_vph
 * @property {number | null} time_mean_speed_mps
 * @property {number | null} space_mean_speed_mps
 * @property {number | null} p85_speed_mps
 * @property {number} occupancy_percent
 * @property {number} density_per_km
 * @property {number | null} mean_headway_s
 * @property {string[]} quality
 */

/**
 * @typedef {object} Crossing
 * @property {string} timestamp
 * @property {string | null} lane_id
 * @property {string} track_id
 * @property {number} frame
 * @property {number} speed_mps
 * @property {number | null} length_m
 * @property {number | null} headway_s
 * @property {number} probability
 */

/** @typedef {{startMs: number, endMs: number, interval: string}} Window */
/** @typedef {{frame: number, timestamp: string, tracks: {track_id: string, x_m: number, y_m: number, vx_mps: number, vy_mps: number, lane: number | null}[]}} StateLine */
/** @typedef {{lane_id: string, index: number, name?: string, direction: string, points_m: [number, number][]}} Lane */

/** @param {string} sensorId */
function pathOf(sensorId) {
  return `api/v1/sensors/${encodeURIComponent(sensorId)}`;
}

/** @param {Window} window */
function times({ startMs, endMs }) {
  return { start: new Date(startMs).toISOString(), end: new Date(endMs).toISOString() };
}

/**
 * @param {string} sensorId
 * @param {Window} window
 * @param {string | null} lineId null: every line
 * @param {string} [format]
 * @returns {string} the address of the flow rows, relative to the page
 */
export function flowPath(sensorId, window, lineId, format) {
  const query = new URLSearchParams({ ...times(window), interval: window.interval, by: "lane,direction" });
  if (lineId !== null) query.set("line_id", lineId);
  if (format === undefined) query.set("histogram", "false");
  else query.set("format", format);
  return `${pathOf(sensorId)}/flow?${query}`;
}

/**
 * @param {string} sensorId
 * @param {Window} window
 * @returns {Promise<FlowRow[]>} by start, line and lane
 */
export async function readFlow(sensorId, window) {
  return (await readJson(flowPath(sensorId, window, null))).items;
}

/**
 * Return the rows of intervals that have ended, or of the one that runs where there is no other: what was
 * counted in its first seconds is no rate of flow yet, and reads as if the traffic had stopped.
 * @param {FlowRow[]} rows
 * @param {number} nowMs
 * @returns {FlowRow[]}
 */
export function ended(rows, nowMs) {
  const over = rows.filter((row) => Date.parse(row.end) <= nowMs || !row.quality.includes("partial"));
  return over.length > 0 ? over : rows;
}

/**
 * @param {string} sensorId
 * @param {string} row
 * @returns {Promise<{flow: FlowRow, crossings: Crossing[], tracks: {track_id: string}[], frames: {first: number | null, last: number | null, start: string | null, end: string | null}}>}
 */
export async function readEvidence(sensorId, row) {
  return readJson(`${pathOf(sensorId)}/flow/${encodeURIComponent(row)}/evidence`);
}

/**
 * @param {string} sensorId
 * @param {Window} window
 * @returns {Promise<{start: string, end: string, coverage: number, observed: number}[]>}
 */
export async function readCoverage(sensorId, window) {
  const query = new URLSearchParams({ ...times(window), interval: window.interval });
  return (await readJson(`${pathOf(sensorId)}/coverage?${query}`)).items;
}

/**
 * @param {string} sensorId
 * @returns {Promise<Lane[]>} of the newest lane map
 */
export async function readLanes(sensorId) {
  return (await readJson(`${pathOf(sensorId)}/lanes`)).lanes;
}

/**
 * @param {string} sensorId
 * @param {Window} window
 * @returns {Promise<StateLine[]>}
 */
export async function readStates(sensorId, window) {
  const response = await request(`${pathOf(sensorId)}/states?${new URLSearchParams(times(window))}`, {
    headers: { Accept: "application/x-ndjson" },
  });
  const text = await response.text();
  return text
    .split("\n")
    .filter((line) => line !== "")
    .map((line) => JSON.parse(line));
}

/**
 * @param {string} sensorId
 * @returns {Promise<number | null>} time of its newest frame [ms]
 */
export async function readNewestMs(sensorId) {
  const { timestamp } = await readJson(`${pathOf(sensorId)}/live`);
  return timestamp === null ? null : Date.parse(timestamp);
}

/**
 * @typedef {object} Check
 * @property {string} line_id
 * @property {string | null} lane_id
 * @property {string} start
 * @property {number} interval_s
 * @property {number} counted
 * @property {number | null} measured
 * @property {number | null} difference
 * @property {number | null} geh
 * @property {boolean | null} within_target
 */

/**
 * @param {string} sensorId
 * @returns {Promise<Check[]>}
 */
export async function readChecks(sensorId) {
  return (await readJson(`${pathOf(sensorId)}/counts/checks`)).items;
}

/**
 * Keep a count by hand; needs the scope admin.
 * @param {string} sensorId
 * @param {{line_id: string, start: string, interval_s: number, counted: number}} count
 */
export async function sendCheck(sensorId, count) {
  await readJson(`${pathOf(sensorId)}/counts/checks`, {
    method: "POST",
    headers: { "Content-Type": "application/json" },
    body: JSON.stringify([count]),
  });
}
