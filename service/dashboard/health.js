// How the sensor that is shown does: rate, age, backlog, gaps, log.

import { Problem, readJson, request } from "./api.js";
import { showFacts } from "./facts.js";
import { bytesText, durationText, NONE, numberText } from "./format.js";
import { countersOf, Rates } from "./metrics.js";

const PERIOD_MS = 2000;
const QUEUE_LONG = 40; // records: two seconds at 20 frames/s
const STORED_LATE_S = 5; // rows are stored each second
const CLOCK_OFF_S = 1;

/** Asks for the health of the server as long as somebody looks. */
export class Health {
  #rates = new Rates();
  /** @type {any} */
  #reply = null;
  #sensorId = "";

  /**
   * @param {{list: HTMLElement, failure: HTMLElement, version: HTMLElement}} places
   * @param {import("./state.js").Store} store
   */
  constructor(places, store) {
    this.places = places;
    this.store = store;
    setInterval(() => this.#ask(), PERIOD_MS);
    document.addEventListener("visibilitychange", () => this.#ask());
    store.subscribe((state) => {
      if ((state.sensorId ?? "") === this.#sensorId) return;
      this.#sensorId = state.sensorId ?? "";
      this.#rates.clear();
      this.#show();
      this.#ask();
    });
  }

  async #ask() {
    const { access, sensorId } = this.store.state;
    if (document.hidden || (access !== "open" && access !== "session")) return;
    try {
      this.#reply = await readJson("healthz");
      const atMs = performance.now(); // close to the time of counting; the reply may wait for a busy page
      const response = await request("metrics", { headers: { Accept: "text/plain" } });
      const text = await response.text();
      if (sensorId !== null && sensorId === this.#sensorId) this.#rates.add(countersOf(text, sensorId), atMs);
    } catch (error) {
      if (error instanceof Problem && error.status === 401) this.store.set({ access: "signed-out" });
      this.#reply = null; // what is not known is not shown; the live poll tells of the failure
    }
    this.#show();
  }

  #show() {
    const sensor = this.#reply?.sensors.find((/** @type {any} */ one) => one.sensor_id === this.#sensorId) ?? null;
    showFacts(this.places.list, this.#facts(sensor));
    const failure = this.#failureText(sensor);
    this.places.failure.hidden = failure === "";
    if (this.places.failure.textContent !== failure) this.places.failure.textContent = failure;
    this.places.version.textContent = this.#reply ? `Wayside ${this.#reply.version}` : "";
  }

  /**
   * @param {any} sensor
   * @returns {import("./facts.js").Fact[]}
   */
  #facts(sensor) {
    const rates = sensor ? this.#rates.now : { framesPerS: null, pointsPerFrame: null, missing: null };
    const queue = sensor?.queue_depth ?? null;
    const ahead = sensor?.clock_ahead_s ?? null;
    return [
      { name: "Frame rate", value: numberText(rates.framesPerS, 1, "/s"), hint: "Frames tracked, over ten seconds" },
      { name: "Points", value: numberText(rates.pointsPerFrame, 0, "a frame") },
      { name: "Last frame", value: agoText(sensor?.frame_age_s), bad: sensor?.state === "stale" },
      { name: "Backlog", value: framesText(queue), hint: "Logged and not tracked yet", bad: queue > QUEUE_LONG },
      { name: "Missing", value: framesText(rates.missing), hint: "Frame numbers that never came, since the server started" },
      { name: "Stored", value: agoText(sensor?.stored_age_s), bad: sensor?.state === "live" && sensor.stored_age_s > STORED_LATE_S },
      { name: "Clock", value: clockText(ahead), hint: "The sensor's clock against the server's, transport included", bad: Math.abs(ahead ?? 0) > CLOCK_OFF_S },
      { name: "Log", value: bytesText(this.#reply?.log_bytes), hint: "Frames kept on disk, of all sensors" },
    ];
  }

  /** @param {any} sensor */
  #failureText(sensor) {
    if (sensor?.failure) return `Not tracked any more: ${sensor.failure}`;
    const damaged = this.#reply?.log_damaged_records ?? 0;
    if (damaged > 0) return `${damaged} damaged records of the log were left out.`;
    return this.#reply?.status === "degraded" ? "The service is degraded; see its log." : "";
  }
}

/** @param {number | null | undefined} ageS */
function agoText(ageS) {
  return ageS == null ? NONE : `${durationText(ageS)} ago`;
}

/** @param {number | null} count */
function framesText(count) {
  if (count === null) return NONE;
  return count === 1 ? "1 frame" : `${count} frames`;
}

/** @param {number | null} aheadS */
function clockText(aheadS) {
  if (aheadS === null) return NONE;
  const size = Math.abs(aheadS) < 1 ? `${Math.round(Math.abs(aheadS) * 1000)} ms` : durationText(Math.abs(aheadS));
  return `${size} ${aheadS > 0 ? "ahead" : "behind"}`;
}
