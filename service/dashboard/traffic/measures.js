// The numbers of one interval, lane by lane, each with a way into its evidence.

import { numberText, speedNumber, UNITS } from "../format.js";
import { laneKey } from "./charts.js";
import { fillTable, newButton } from "./table.js";

const PERCENT = 100;

/** @typedef {import("./data.js").FlowRow} FlowRow */

/**
 * @param {HTMLTableElement} table
 * @param {FlowRow[]} rows of one interval
 * @param {import("../format.js").Unit} unit
 * @param {(row: FlowRow) => void} onEvidence
 */
export function showMeasures(table, rows, unit, onEvidence) {
  const speed = (/** @type {number | null} */ speedMps) => speedNumber(speedMps, unit);
  const label = UNITS[unit].label;
  fillTable(
    table,
    [
      { name: "Line", word: true, value: (row) => row.line_id },
      { name: "Lane", word: true, value: laneKey, hint: "Arrow: to the left or right of the way from the line's first end to its second" },
      { name: "Vehicles", value: (row) => String(row.volume) },
      { name: "95 %", value: (row) => `${row.volume_low}\u2013${row.volume_high}`, hint: "Bounds of the true volume, from existence probabilities and frame loss" },
      { name: "veh/h", value: (row) => numberText(row.flow_vph, 0) },
      { name: `Mean ${label}`, value: (row) => speed(row.space_mean_speed_mps), hint: "Space-mean speed" },
      { name: `p85 ${label}`, value: (row) => speed(row.p85_speed_mps) },
      { name: "Occupancy %", value: (row) => numberText(row.occupancy_percent, 1) },
      { name: "veh/km", value: (row) => numberText(row.density_per_km, 1) },
      { name: "Headway s", value: (row) => numberText(row.mean_headway_s, 1) },
      { name: "Coverage %", value: (row) => numberText(row.coverage * PERCENT, 0) },
      { name: "Notes", word: true, value: (row) => row.quality.join(", ").replaceAll("_", " ") },
      {
        name: "",
        value: (row) => newButton("Evidence", `Evidence behind the ${row.volume} vehicles of ${row.line_id}, ${laneKey(row)}`, () => onEvidence(row)),
      },
    ],
    rows,
  );
}
