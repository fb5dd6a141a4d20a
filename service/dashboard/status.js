// Say how fresh the picture is: in the bar, in a banner when it is not, and in the title of the tab.

import { durationText } from "./format.js";

const PERIOD_MS = 500;

/** @type {Record<string, string>} */
const WORDS = {
  starting: "Connecting",
  live: "Live",
  waiting: "Waiting",
  stale: "No data",
  unreachable: "Unreachable",
};

/** Shows it, and keeps the age in the banner going. */
export class Status {
  /**
   * @param {{state: HTMLElement, banner: HTMLElement, age: HTMLElement, picture: HTMLElement}} places
   * @param {import("./state.js").Store} store
   */
  constructor(places, store) {
    this.places = places;
    this.store = store;
    store.subscribe(() => this.#show());
    setInterval(() => this.#show(), PERIOD_MS);
  }

  #show() {
    const { access, sensors, sensorId } = this.store.state;
    const { state, banner, age, picture } = this.places;
    const freshness = sensors?.length === 0 && this.store.freshness === "starting" ? "waiting" : this.store.freshness;
    const text = access === "signed-out" ? "" : this.#bannerText(freshness);
    state.hidden = access === "signed-out";
    if (state.dataset.state !== freshness) {
      state.dataset.state = freshness;
      /** @type {HTMLElement} */ (state.lastElementChild).textContent = WORDS[freshness];
    }
    // The age stands outside what a screen reader announces, or it would do so twice a second.
    if (banner.textContent !== text) banner.textContent = text;
    age.textContent = text === "" ? "" : `(${wholeSeconds(this.#silentS(freshness))})`;
    /** @type {HTMLElement} */ (banner.parentElement).hidden = text === "";
    picture.classList.toggle("stale", text !== "");
    const mark = text === "" ? "" : "⚠ ";
    document.title = `${mark}${sensorId === null ? "" : `${sensorId} · `}Wayside`;
  }

  /** @param {string} freshness */
  #bannerText(freshness) {
    const { sensorId, live } = this.store.state;
    if (freshness === "unreachable") {
      return `The server cannot be reached.${live === null ? "" : " The picture is out of date."} Trying again.`;
    }
    return freshness === "stale" ? `No frames from ${sensorId}. The picture is out of date.` : "";
  }

  /** @param {string} freshness */
  #silentS(freshness) {
    const failingS = (performance.now() - (this.store.state.failingSinceMs ?? 0)) / 1000;
    return freshness === "unreachable" ? failingS : (this.store.ageS ?? 0);
  }
}

/** @param {number} durationS */
function wholeSeconds(durationS) {
  return durationText(Math.max(Math.floor(durationS), 0)).replace(".0", "");
}
