// Hold counts by hand against the measured volumes.

import { Problem } from "../api.js";
import { NONE, numberText } from "../format.js";
import { readChecks, sendCheck } from "./data.js";
import { fillTable } from "./table.js";

const QUARTER_S = 900;
const SHOWN = 12; // the newest

/** @typedef {() => {sensorId: string | null, lineId: string | null}} Chosen */

/** The panel with the table of comparisons and the form for a count. */
export class Checks {
  /**
   * @param {{table: HTMLTableElement, form: HTMLFormElement, start: HTMLInputElement, count: HTMLInputElement, failure: HTMLElement}} places
   * @param {Chosen} chosen sensor and line of the page
   */
  constructor(places, chosen) {
    this.places = places;
    this.chosen = chosen;
    places.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#send();
    });
  }

  async refresh() {
    const { sensorId } = this.chosen();
    if (sensorId === null) return;
    const checks = (await readChecks(sensorId)).slice(-SHOWN).reverse();
    fillTable(
      this.places.table,
      [
        { name: "From", word: true, value: (check) => new Date(check.start).toLocaleString() },
        { name: "Line", word: true, value: (check) => check.line_id },
        { name: "By hand", value: (check) => String(check.counted) },
        { name: "Measured", value: (check) => (check.measured === null ? NONE : String(check.measured)) },
        { name: "Difference", value: (check) => numberText(check.difference, 0) },
        { name: "GEH", value: (check) => numberText(check.geh, 2), hint: "Of hourly volumes; below 5 is the usual target" },
        { name: "", word: true, value: (check) => verdict(check.within_target) },
      ],
      checks,
    );
  }

  async #send() {
    const { sensorId, lineId } = this.chosen();
    const { start, count, failure } = this.places;
    if (sensorId === null) return;
    failure.hidden = true;
    try {
      if (lineId === null) throw new Problem(422, "choose a count line first");
      const at = new Date(start.value).toISOString();
      await sendCheck(sensorId, { line_id: lineId, start: at, interval_s: QUARTER_S, counted: Number(count.value) });
      count.value = "";
      await this.refresh();
    } catch (error) {
      failure.textContent = error instanceof Problem ? `Not kept: ${error.message}.` : "The server cannot be reached.";
      failure.hidden = false;
    }
  }
}

/** @param {boolean | null} within */
function verdict(within) {
  if (within === null) return "not observed";
  return within ? "within target" : "outside target";
}
