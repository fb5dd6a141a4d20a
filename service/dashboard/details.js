// All that is known of the vehicle that is highlighted.

import { showFacts } from "./facts.js";
import { durationText, NONE, numberText, speedText, wordText } from "./format.js";

const PERIOD_MS = 250;
const TWO_SIGMA = 2; // half-widths of 95 % intervals
const PERCENT = 100;
const FULL_TURN_DEG = 360;

/**
 * @param {import("./state.js").Track} track
 * @param {import("./format.js").Unit} unit
 * @returns {import("./facts.js").Fact[]}
 */
function factsOf(track, unit) {
  const spread = (/** @type {number} */ stdM) => `± ${numberText(TWO_SIGMA * stdM, 2, "m")}`;
  return [
    { name: "Speed", value: speedText(track.speed_mps, unit) },
    { name: "Heading", value: headingText(track.heading_deg), hint: "Clockwise from straight ahead" },
    { name: "x", value: `${numberText(track.x_m, 2)} ${spread(track.std_x_m)}`, hint: "To the right of the radar, with its 95 % interval" },
    { name: "y", value: `${numberText(track.y_m, 2)} ${spread(track.std_y_m)}`, hint: "Ahead of the radar, with its 95 % interval" },
    { name: "Size", value: `${numberText(track.length_m, 1)} × ${numberText(track.width_m, 1, "m")}`, hint: "Length and width" },
    { name: "Class", value: wordText(track.length_class), hint: "By length" },
    ...(track.lane === null ? [] : [{ name: "Lane", value: String(track.lane) }]),
    { name: "Status", value: wordText(track.status) },
    { name: "Existence", value: numberText(track.existence * PERCENT, 1, "%"), hint: "Probability that it is a vehicle" },
    { name: "Age", value: durationText(track.age_s) },
    { name: "Hits", value: String(track.hits), hint: "Frames in which it was seen" },
    { name: "Place", value: placeText(track), hint: "Latitude and longitude (WGS 84)" },
  ];
}

/** @param {number | null} headingDeg */
function headingText(headingDeg) {
  return headingDeg === null ? NONE : `${Math.round(headingDeg) % FULL_TURN_DEG}°`;
}

/** @param {import("./state.js").Track} track */
function placeText({ latitude_deg: latitude, longitude_deg: longitude }) {
  return latitude === null || longitude === null ? NONE : `${latitude.toFixed(6)}, ${longitude.toFixed(6)}`;
}

/** Follows the selection. */
export class Details {
  #shownAtMs = 0;
  #key = "";

  /**
   * @param {HTMLElement} panel
   * @param {import("./state.js").Store} store
   */
  constructor(panel, store) {
    this.panel = panel;
    this.title = /** @type {HTMLElement} */ (panel.querySelector("h2"));
    this.list = /** @type {HTMLElement} */ (panel.querySelector("dl"));
    this.store = store;
    panel.querySelector("button")?.addEventListener("click", () => store.set({ selected: null }));
    store.subscribe((state) => this.#show(state));
  }

  /** @param {import("./state.js").State} state */
  #show({ selected, live, preferences }) {
    this.panel.hidden = selected === null;
    const key = `${selected} ${preferences.units}`;
    if (selected === null || (key === this.#key && performance.now() - this.#shownAtMs < PERIOD_MS)) return;
    this.#shownAtMs = performance.now();
    const track = live?.tracks.find(({ track_id: id }) => id === selected);
    this.title.textContent = track ? selected : `${selected} (gone)`;
    this.panel.classList.toggle("gone", !track);
    if (track) showFacts(this.list, factsOf(track, preferences.units));
    else if (key !== this.#key) this.list.replaceChildren();
    this.#key = key;
  }
}
