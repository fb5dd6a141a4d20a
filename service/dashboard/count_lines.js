// Draw, name and take away the lines at which vehicles are counted.

import { patchSensor, Problem } from "./api.js";

const ENDS = 2;
const ROUND = 100; // a centimetre is finer than a finger
const HINTS = [
  "Tap one end of the line on the plan.",
  "Tap the other end.",
  "Tap again to move the second end, or name the line and save it.",
];

/**
 * @typedef {import("./state.js").CountLine} CountLine
 * @typedef {import("./state.js").State} State
 */

/** The panel that lists the lines and holds the form for a new one. */
export class CountLines {
  #key = "";
  #busy = false;

  /**
   * @param {HTMLElement} panel
   * @param {import("./state.js").Store} store
   */
  constructor(panel, store) {
    this.panel = panel;
    this.store = store;
    this.list = this.#part("#lines-list");
    this.none = this.#part("#lines-none");
    this.form = /** @type {HTMLFormElement} */ (this.#part("#line-form"));
    this.hint = this.#part("#line-hint");
    this.name = /** @type {HTMLInputElement} */ (this.#part("#line-name"));
    this.save = /** @type {HTMLButtonElement} */ (this.#part("#line-save"));
    this.draw = this.#part("#line-draw");
    this.failure = this.#part("#line-failure");
    this.draw.addEventListener("click", () => this.#begin());
    this.#part("#line-cancel").addEventListener("click", () => store.set({ draft: null }));
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#add();
    });
    store.subscribe((state) => this.#show(state));
  }

  /**
   * @param {string} selector
   * @returns {HTMLElement}
   */
  #part(selector) {
    return /** @type {HTMLElement} */ (this.panel.querySelector(selector));
  }

  #begin() {
    this.name.value = freeName(this.store.sensor?.count_lines ?? []);
    this.failure.hidden = true;
    this.store.set({ draft: [], selected: null });
  }

  /** @param {State} state */
  #show({ draft }) {
    const sensor = this.store.sensor;
    this.panel.hidden = sensor === null;
    const lines = sensor?.count_lines ?? [];
    const key = JSON.stringify([sensor?.sensor_id, lines, draft]);
    if (key === this.#key) return;
    this.#key = key;
    this.list.replaceChildren(...lines.map((line) => this.#item(line)));
    this.none.hidden = lines.length > 0 || draft !== null;
    this.form.hidden = draft === null;
    this.draw.hidden = draft !== null;
    this.hint.textContent = HINTS[draft?.length ?? 0];
    this.save.disabled = draft === null || draft.length < ENDS;
    document.body.classList.toggle("drawing", draft !== null);
  }

  /**
   * @param {CountLine} line
   * @returns {HTMLLIElement}
   */
  #item(line) {
    const item = document.createElement("li");
    const name = document.createElement("span");
    name.textContent = line.line_id;
    const remove = document.createElement("button");
    remove.type = "button";
    remove.textContent = "Remove";
    remove.setAttribute("aria-label", `Remove the count line ${line.line_id}`);
    remove.addEventListener("click", () => {
      const kept = (this.store.sensor?.count_lines ?? []).filter(({ line_id: id }) => id !== line.line_id);
      this.#store(kept);
    });
    item.append(name, remove);
    return item;
  }

  async #add() {
    const { draft } = this.store.state;
    const lines = this.store.sensor?.count_lines ?? [];
    const name = this.name.value.trim();
    if (draft === null || draft.length < ENDS || name === "") return;
    if (lines.some(({ line_id: id }) => id === name)) {
      this.#tell(`There is a line ${name} already.`);
      return;
    }
    const [p0, p1] = draft.map(([xM, yM]) => /** @type {[number, number]} */ ([rounded(xM), rounded(yM)]));
    if (await this.#store([...lines, { line_id: name, p0, p1 }])) this.store.set({ draft: null });
  }

  /**
   * Send the lines that the sensor shall have.
   * @param {CountLine[]} lines
   * @returns {Promise<boolean>} false: the server refused, and the panel says why
   */
  async #store(lines) {
    const { sensorId } = this.store.state;
    if (sensorId === null || this.#busy) return false;
    this.#busy = true;
    try {
      const changed = await patchSensor(sensorId, { count_lines: lines });
      this.failure.hidden = true;
      const { sensors } = this.store.state;
      this.store.set({ sensors: (sensors ?? []).map((known) => (known.sensor_id === sensorId ? changed : known)) });
      return true;
    } catch (error) {
      this.#tell(error instanceof Problem ? `The line was not changed: ${error.message}.` : "The server cannot be reached.");
      return false;
    } finally {
      this.#busy = false;
    }
  }

  /** @param {string} text */
  #tell(text) {
    this.failure.textContent = text;
    this.failure.hidden = false;
  }
}

/**
 * @param {CountLine[]} lines
 * @returns {string} the first of "Line 1", "Line 2", ... that no line has
 */
function freeName(lines) {
  const names = new Set(lines.map(({ line_id: id }) => id));
  let number = 1;
  while (names.has(`Line ${number}`)) number += 1;
  return `Line ${number}`;
}

/** @param {number} valueM */
function rounded(valueM) {
  return Math.round(valueM * ROUND) / ROUND;
}
