// Read the counters of one sensor out of the Prometheus text, and turn them into rates.

const WINDOW_MS = 10_000; // rates are taken over this time
const WINDOW_MIN_MS = 3500; // over less, the way of the replies shows in the rate
const FRAMES = "wayside_frames_total";
const POINTS = "wayside_points_total";
const MISSING = "wayside_frames_missing_total";
const TRACKED = new Set(["tracked", "held"]); // a held frame is tracked a moment later

/** @typedef {{frames: number, points: number, missing: number}} Counters */

/**
 * @param {string} text as of /metrics
 * @param {string} sensorId
 * @returns {Counters} since the server started
 */
export function countersOf(text, sensorId) {
  const counters = { frames: 0, points: 0, missing: 0 };
  const own = `sensor_id="${sensorId}"`;
  for (const line of text.split("\n")) {
    if (!line.includes(own)) continue;
    const [name] = line.split("{", 1);
    const value = Number(line.slice(line.lastIndexOf(" ") + 1));
    const fate = /fate="(\w+)"/.exec(line)?.[1];
    if (name === FRAMES && fate !== undefined && TRACKED.has(fate)) counters.frames += value;
    if (name === POINTS) counters.points = value;
    if (name === MISSING) counters.missing = value;
  }
  return counters;
}

/** Keeps the counters of the last seconds. */
export class Rates {
  /** @type {{atMs: number, counters: Counters}[]} */
  #samples = [];

  /**
   * @param {Counters} counters
   * @param {number} atMs
   */
  add(counters, atMs) {
    const last = this.#samples.at(-1);
    if (last && counters.frames < last.counters.frames) this.#samples = []; // the server has started anew
    this.#samples.push({ atMs, counters });
    while (atMs - this.#samples[0].atMs > WINDOW_MS) this.#samples.shift();
  }

  clear() {
    this.#samples = [];
  }

  /** @returns {{framesPerS: number | null, pointsPerFrame: number | null, missing: number | null}} */
  get now() {
    const [first, last] = [this.#samples[0], this.#samples.at(-1)];
    if (!first || !last) return { framesPerS: null, pointsPerFrame: null, missing: null };
    const spentMs = last.atMs - first.atMs;
    const frames = last.counters.frames - first.counters.frames;
    const points = last.counters.points - first.counters.points;
    return {
      framesPerS: spentMs >= WINDOW_MIN_MS ? (frames / spentMs) * 1000 : null,
      pointsPerFrame: frames > 0 ? points / frames : null,
      missing: last.counters.missing,
    };
  }
}
