// The list of vehicles beside the plan: sorted, and kept row by row so that focus and selection stay.

import { durationText, numberText, shortId, speedNumber, UNITS, wordText } from "./format.js";

/** @typedef {import("./state.js").Track} Track */
/** @typedef {import("./format.js").Unit} Unit */

/**
 * @typedef {object} Column
 * @property {string} key
 * @property {string} title
 * @property {string} [hint]
 * @property {boolean} [number]
 * @property {(track: Track) => number | string} order
 * @property {(track: Track, unit: Unit) => string} text
 */

const STATUS_ORDER = { confirmed: 0, coasting: 1, tentative: 2, deleted: 3 };
const PERIOD_MS = 250; // people cannot read numbers that change faster

/** @type {Column[]} */
const COLUMNS = [
  {
    key: "id",
    title: "Id",
    order: (track) => Number(shortId(track.track_id)),
    text: (track) => shortId(track.track_id),
  },
  {
    key: "class",
    title: "Class",
    hint: "By length",
    order: (track) => track.length_m ?? 0,
    text: (track) => wordText(track.length_class),
  },
  {
    key: "speed",
    title: "Speed",
    number: true,
    order: (track) => track.speed_mps,
    text: (track, unit) => speedNumber(track.speed_mps, unit),
  },
  {
    key: "x",
    title: "x m",
    hint: "To the right of the radar",
    number: true,
    order: (track) => track.x_m,
    text: (track) => numberText(track.x_m, 1),
  },
  {
    key: "y",
    title: "y m",
    hint: "Ahead of the radar",
    number: true,
    order: (track) => track.y_m,
    text: (track) => numberText(track.y_m, 1),
  },
  {
    key: "age",
    title: "Age",
    number: true,
    order: (track) => track.age_s,
    text: (track) => durationText(track.age_s),
  },
  {
    key: "status",
    title: "Status",
    order: (track) => STATUS_ORDER[track.status],
    text: (track) => wordText(track.status),
  },
];

/** Shows the tracks of the newest view. */
export class TrackTable {
  /** @type {Map<string, HTMLTableRowElement>} */
  #rows = new Map();
  #sortKey = "y";
  #descending = true; // far to near, as on the plan
  #drawnAtMs = 0;
  #timer = 0;
  /** @type {Unit} */
  #unit = "kmh";

  /**
   * @param {HTMLTableElement} table
   * @param {import("./state.js").Store} store
   */
  constructor(table, store) {
    this.table = table;
    this.store = store;
    this.body = table.tBodies[0];
    this.heads = COLUMNS.map((column) => this.#head(column));
    table.tHead.rows[0].append(...this.heads);
    this.#showSorting();
    this.body.addEventListener("click", (event) => this.#toggle(/** @type {Element} */ (event.target)));
    store.subscribe(() => this.#later());
  }

  /** @param {Column} column */
  #head(column) {
    const head = document.createElement("th");
    head.scope = "col";
    head.className = classOf(column);
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = column.title;
    if (column.hint) button.title = column.hint;
    button.addEventListener("click", () => {
      this.#descending = this.#sortKey === column.key ? !this.#descending : false;
      this.#sortKey = column.key;
      this.#showSorting();
      this.#show();
    });
    head.append(button);
    return head;
  }

  #showSorting() {
    COLUMNS.forEach((column, i) => {
      if (column.key === this.#sortKey) {
        this.heads[i].setAttribute("aria-sort", this.#descending ? "descending" : "ascending");
      } else {
        this.heads[i].removeAttribute("aria-sort");
      }
    });
  }

  /** @param {Element} target */
  #toggle(target) {
    const row = target.closest("tr");
    const id = row?.dataset.track ?? null;
    if (id !== null) this.store.set({ selected: this.store.state.selected === id ? null : id });
  }

  /** Show soon, but not too often; a change of selection or units at once. */
  #later() {
    const { selected, preferences } = this.store.state;
    if (selected !== (this.table.dataset.selected ?? null) || preferences.units !== this.#unit) {
      this.#show();
    } else if (this.#timer === 0) {
      const leftMs = Math.max(0, PERIOD_MS - (performance.now() - this.#drawnAtMs));
      this.#timer = setTimeout(() => this.#show(), leftMs);
    }
  }

  #show() {
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#drawnAtMs = performance.now();
    const { live, selected, preferences } = this.store.state;
    this.#unit = preferences.units;
    if (selected === null) delete this.table.dataset.selected;
    else this.table.dataset.selected = selected;
    const speed = COLUMNS.findIndex((column) => column.key === "speed");
    this.heads[speed].firstElementChild.textContent = UNITS[this.#unit].label;
    const tracks = this.#sorted(live?.tracks ?? []);
    const present = new Set(tracks.map((track) => track.track_id));
    for (const [id, row] of this.#rows) {
      if (present.has(id)) continue;
      row.remove();
      this.#rows.delete(id);
    }
    const focused = document.activeElement;
    tracks.forEach((track, place) => this.#showRow(track, place, track.track_id === selected));
    if (focused instanceof HTMLElement && focused !== document.activeElement && this.body.contains(focused)) {
      focused.focus({ preventScroll: true }); // a row that changes its place loses it
    }
  }

  /** @param {Track[]} tracks */
  #sorted(tracks) {
    const column = COLUMNS.find(({ key }) => key === this.#sortKey) ?? COLUMNS[0];
    const sign = this.#descending ? -1 : 1;
    return [...tracks].sort((a, b) => {
      const [first, second] = [column.order(a), column.order(b)];
      return first < second ? -sign : first > second ? sign : 0;
    });
  }

  /**
   * @param {Track} track
   * @param {number} place
   * @param {boolean} selected
   */
  #showRow(track, place, selected) {
    let row = this.#rows.get(track.track_id);
    if (row === undefined) {
      row = newRow(track.track_id);
      this.#rows.set(track.track_id, row);
    }
    const before = this.body.rows[place];
    if (before !== row) this.body.insertBefore(row, before ?? null);
    row.className = `${track.status}${selected ? " selected" : ""}`;
    const button = /** @type {HTMLButtonElement} */ (row.querySelector("button"));
    button.setAttribute("aria-pressed", String(selected));
    COLUMNS.forEach((column, i) => {
      const target = i === 0 ? button : row.cells[i];
      const text = column.text(track, this.#unit);
      if (target.textContent !== text) target.textContent = text;
    });
  }
}

/** @param {Column} column */
function classOf({ key, number }) {
  return number ? `of-${key} number` : `of-${key}`;
}

/** @param {string} trackId */
function newRow(trackId) {
  const row = document.createElement("tr");
  row.dataset.track = trackId;
  for (const column of COLUMNS) {
    const cell = row.insertCell();
    cell.className = classOf(column);
  }
  const button = document.createElement("button");
  button.type = "button";
  button.title = trackId;
  row.cells[0].append(button);
  return row;
}
