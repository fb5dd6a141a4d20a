// What stands behind a number: the crossings, tracks and frames that it was computed from.

import { showFacts } from "../facts.js";
import { NONE, numberText, speedText } from "../format.js";
import { laneKey } from "./charts.js";
import { readEvidence } from "./data.js";
import { fillTable } from "./table.js";

const PERCENT = 100;

/** The dialog that shows it. */
export class Evidence {
  /** @param {HTMLDialogElement} dialog */
  constructor(dialog) {
    this.dialog = dialog;
    this.title = /** @type {HTMLElement} */ (dialog.querySelector("h2"));
    this.facts = /** @type {HTMLElement} */ (dialog.querySelector("dl"));
    this.table = /** @type {HTMLTableElement} */ (dialog.querySelector("table"));
    dialog.querySelector("button")?.addEventListener("click", () => dialog.close());
  }

  /**
   * @param {string} sensorId
   * @param {import("./data.js").FlowRow} row
   * @param {import("../format.js").Unit} unit
   */
  async open(sensorId, row, unit) {
    const { flow, crossings, tracks, frames } = await readEvidence(sensorId, row.row);
    this.title.textContent = `${row.line_id}, ${laneKey(row)}: ${row.volume} vehicles from ${new Date(row.start).toLocaleString()}`;
    showFacts(this.facts, [
      { name: "Computed again", value: `${flow.volume} vehicles`, hint: "From the crossings below", bad: flow.volume !== row.volume },
      { name: "Crossings", value: String(crossings.length) },
      { name: "Tracks", value: String(tracks.length) },
      { name: "Frames", value: frames.first === null ? NONE : `${frames.first}\u2013${frames.last}` },
    ]);
    fillTable(
      this.table,
      [
        { name: "Time", word: true, value: (crossing) => timeText(crossing.timestamp) },
        { name: "Track", word: true, value: (crossing) => crossing.track_id },
        { name: "Lane", word: true, value: (crossing) => crossing.lane_id ?? NONE },
        { name: "Frame", value: (crossing) => String(crossing.frame) },
        { name: "Speed", value: (crossing) => speedText(crossing.speed_mps, unit) },
        { name: "Length m", value: (crossing) => numberText(crossing.length_m, 1) },
        { name: "Headway s", value: (crossing) => numberText(crossing.headway_s, 1) },
        { name: "Real %", value: (crossing) => numberText(crossing.probability * PERCENT, 0), hint: "Probability that the crossing is real" },
      ],
      crossings,
    );
    this.dialog.dataset.crossings = String(crossings.length);
    if (!this.dialog.open) this.dialog.showModal();
  }
}

/** @param {string} timestamp */
function timeText(timestamp) {
  const at = new Date(timestamp);
  return `${at.toLocaleTimeString([], { hour12: false })}.${String(at.getMilliseconds()).padStart(3, "0")}`;
}
