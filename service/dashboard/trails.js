// Where the vehicles were in the last seconds.

const SPAN_MS = 5000;
const STEP_MS = 200; // finer does not show

/** @typedef {{xM: number, yM: number, speedMps: number, atMs: number}} Place */

/** Remembers the way of every track, also for a while after it has ended. */
export class Trails {
  /** @type {Map<string, Place[]>} */
  #ways = new Map();

  /**
   * @param {import("./state.js").Track[]} tracks
   * @param {number} atMs
   */
  add(tracks, atMs) {
    for (const track of tracks) {
      const way = this.#ways.get(track.track_id) ?? [];
      if (way.length && atMs - way[way.length - 1].atMs < STEP_MS) continue;
      way.push({ xM: track.x_m, yM: track.y_m, speedMps: track.speed_mps, atMs });
      this.#ways.set(track.track_id, way);
    }
    this.#forget(atMs);
  }

  clear() {
    this.#ways.clear();
  }

  /**
   * @param {number} nowMs
   * @returns {{id: string, way: Place[]}[]} each with its oldest place first
   */
  recent(nowMs) {
    this.#forget(nowMs);
    return [...this.#ways].map(([id, way]) => ({ id, way }));
  }

  /**
   * @param {Place} place
   * @param {number} nowMs
   * @returns {number} from 1, now, to 0, forgotten
   */
  static freshness(place, nowMs) {
    return Math.min(Math.max(1 - (nowMs - place.atMs) / SPAN_MS, 0), 1);
  }

  /** @param {number} nowMs */
  #forget(nowMs) {
    for (const [id, way] of this.#ways) {
      while (way.length && nowMs - way[0].atMs > SPAN_MS) way.shift();
      if (way.length === 0) this.#ways.delete(id);
    }
  }
}
