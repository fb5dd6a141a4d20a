// Keep the newest tracks of one sensor coming: a paced long poll with an entity tag.

import { Problem, readLive } from "./api.js";

const PERIOD_MS = 125; // at most eight views a second
const HIDDEN_PERIOD_MS = 5000;
const WAIT_S = 1; // short, so that many tabs do not use up the browser's connections to one host
const BACKOFF_MS = [500, 1000, 2000, 4000, 8000];

/**
 * @typedef {object} Listener
 * @property {(view: import("./state.js").LiveView) => void} onView
 * @property {() => void} onContact the server answered, with or without news
 * @property {(error: Error) => void} onFailure
 */

const FINAL = [401, 403, 404]; // signed out, or the sensor is gone: asking again changes nothing

/** Polls one sensor at a time. */
export class LivePoll {
  #run = 0; // counts the sensors followed; a loop ends when it is no longer its turn
  /** @type {AbortController | null} */
  #request = null;
  /** @type {string | null} */
  #etag = null;
  /** @type {number | null} */
  #version = null;
  #points = false;
  #wake = () => {};

  /** @param {Listener} listener */
  constructor(listener) {
    this.listener = listener;
    document.addEventListener("visibilitychange", () => this.#wake());
  }

  /**
   * Follow a sensor, from the next request on; null: none.
   * @param {string | null} sensorId
   */
  follow(sensorId) {
    this.#run += 1;
    this.#forget();
    this.#request?.abort();
    this.#wake();
    if (sensorId !== null) this.#loop(sensorId, this.#run);
  }

  /** @param {boolean} wanted whether the raw points come too */
  set points(wanted) {
    if (wanted === this.#points) return;
    this.#points = wanted;
    this.#forget();
    this.#wake();
  }

  #forget() {
    this.#etag = null;
    this.#version = null;
  }

  /**
   * @param {string} sensorId
   * @param {number} run
   */
  async #loop(sensorId, run) {
    let failures = 0;
    while (run === this.#run) {
      const begunMs = performance.now();
      try {
        await this.#ask(sensorId, run);
        failures = 0;
      } catch (error) {
        if (run !== this.#run) return;
        failures += 1;
        this.listener.onFailure(/** @type {Error} */ (error));
        if (error instanceof Problem && FINAL.includes(error.status)) return;
      }
      if (run === this.#run) await this.#pause(this.#pauseMs(failures, performance.now() - begunMs));
    }
  }

  /**
   * @param {string} sensorId
   * @param {number} run
   */
  async #ask(sensorId, run) {
    const points = this.#points;
    this.#request = new AbortController();
    const reply = await readLive(sensorId, {
      points,
      after: this.#version,
      waitS: document.hidden ? 0 : WAIT_S,
      etag: this.#etag,
      signal: this.#request.signal,
    });
    if (run !== this.#run) return;
    this.listener.onContact();
    if (points !== this.#points) return; // the question changed meanwhile
    this.#etag = reply.etag;
    if (reply.view !== null) {
      this.#version = reply.view.version;
      this.listener.onView(reply.view);
    }
  }

  /**
   * @param {number} failures in a row
   * @param {number} spentMs
   */
  #pauseMs(failures, spentMs) {
    if (failures > 0) return BACKOFF_MS[Math.min(failures, BACKOFF_MS.length) - 1];
    return document.hidden ? HIDDEN_PERIOD_MS : Math.max(0, PERIOD_MS - spentMs);
  }

  /**
   * Wait, but not beyond a change of what is wanted.
   * @param {number} durationMs
   * @returns {Promise<void>}
   */
  #pause(durationMs) {
    return new Promise((resolve) => {
      const timer = setTimeout(resolve, durationMs);
      this.#wake = () => {
        clearTimeout(timer);
        resolve();
      };
    });
  }
}
