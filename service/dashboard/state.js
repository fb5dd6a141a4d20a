// What the page knows, in one value, and who wants to hear of changes.

/**
 * @typedef {object} Track
 * @property {string} track_id
 * @property {"tentative" | "confirmed" | "coasting" | "deleted"} status
 * @property {number} x_m
 * @property {number} y_m
 * @property {number} vx_mps
 * @property {number} vy_mps
 * @property {number} speed_mps
 * @property {number | null} heading_deg clockwise from forward
 * @property {number} std_x_m
 * @property {number} std_y_m
 * @property {number} cov_xy_m2
 * @property {number | null} length_m
 * @property {number | null} width_m
 * @property {string | null} length_class
 * @property {number} existence
 * @property {number} age_s
 * @property {number} hits
 * @property {number | null} lane
 * @property {number | null} longitude_deg
 * @property {number | null} latitude_deg
 */

/**
 * @typedef {object} LiveView
 * @property {string} sensor_id
 * @property {number} version
 * @property {number | null} frame
 * @property {number | null} age_s
 * @property {"waiting" | "live" | "stale"} state
 * @property {Track[]} tracks
 * @property {{x_m: number[], y_m: number[], radial_velocity_mps: (number | null)[]}} [points]
 */

/**
 * @typedef {object} Sensor
 * @property {string} sensor_id
 * @property {string} name
 * @property {{range_min_m: number, range_max_m: number, azimuth_max_deg: number}} region
 * @property {{line_id: string, p0: [number, number], p1: [number, number]}[]} count_lines
 */

/**
 * @typedef {Sensor["count_lines"][number]} CountLine
 */

/**
 * @typedef {object} Preferences
 * @property {import("./format.js").Unit} units
 * @property {boolean} labels
 * @property {boolean} trails
 * @property {boolean} points
 * @property {boolean} lanes
 * @property {string | null} sensorId
 */

/**
 * @typedef {object} State
 * @property {"starting" | "signed-out" | "open" | "session"} access
 * @property {Sensor[] | null} sensors null: not known yet
 * @property {string | null} sensorId
 * @property {LiveView | null} live
 * @property {number} liveAtMs when `live` came, by performance.now()
 * @property {number | null} failingSinceMs null: the server answers
 * @property {string | null} selected id of the track that is highlighted
 * @property {import("./lanes.js").Lane[]} lanes of the sensor that is shown
 * @property {[number, number][] | null} draft ends of a count line that is being drawn, in plan metres; null: none is
 * @property {Preferences} preferences
 */

const STORAGE_KEY = "wayside.dashboard";
const STALE_AFTER_S = 3; // one second more than the server's own limit, for the way to us
const UNREACHABLE_AFTER_MS = 2000;
const WAKING_MS = 1500; // time to ask again after the page was hidden
const UNIT_NAMES = ["kmh", "mps", "mph"];

/** Holds the state; every change goes through `set`. */
export class Store {
  /** @type {((state: State) => void)[]} */
  #listeners = [];

  constructor() {
    /** @type {State} */
    this.state = {
      access: "starting",
      sensors: null,
      sensorId: null,
      live: null,
      liveAtMs: 0,
      failingSinceMs: null,
      selected: null,
      lanes: [],
      draft: null,
      preferences: readPreferences(),
    };
    this.visibleSinceMs = performance.now();
    document.addEventListener("visibilitychange", () => {
      this.visibleSinceMs = performance.now();
    });
  }

  /** @param {(state: State) => void} listener called after every change */
  subscribe(listener) {
    this.#listeners.push(listener);
  }

  /** @param {Partial<State>} changes */
  set(changes) {
    this.state = { ...this.state, ...changes };
    for (const listener of this.#listeners) listener(this.state);
  }

  /** @param {Partial<Preferences>} changes */
  prefer(changes) {
    const preferences = { ...this.state.preferences, ...changes };
    writePreferences(preferences);
    this.set({ preferences });
  }

  /** @returns {Sensor | null} the sensor that is shown */
  get sensor() {
    return this.state.sensors?.find((sensor) => sensor.sensor_id === this.state.sensorId) ?? null;
  }

  /** @returns {number | null} seconds since the newest frame was received by the server */
  get ageS() {
    const { live, liveAtMs } = this.state;
    return live?.age_s == null ? null : live.age_s + (performance.now() - liveAtMs) / 1000;
  }

  /** @returns {"starting" | "unreachable" | "waiting" | "live" | "stale"} how much the picture can be trusted */
  get freshness() {
    const { failingSinceMs, live } = this.state;
    const nowMs = performance.now();
    if (failingSinceMs !== null && nowMs - failingSinceMs > UNREACHABLE_AFTER_MS) return "unreachable";
    if (live === null) return "starting";
    const watching = !document.hidden && nowMs - this.visibleSinceMs > WAKING_MS;
    if (live.state === "live" && watching && (this.ageS ?? 0) > STALE_AFTER_S) return "stale";
    return live.state;
  }
}

/** @returns {Preferences} */
function readPreferences() {
  /** @type {Preferences} */
  const usual = { units: "kmh", labels: true, trails: true, points: false, lanes: true, sensorId: null };
  try {
    const stored = { ...usual, ...JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "{}") };
    return UNIT_NAMES.includes(stored.units) ? stored : usual;
  } catch (error) {
    if (error instanceof DOMException || error instanceof SyntaxError) return usual; // storage forbidden, or damaged
    throw error;
  }
}

/** @param {Preferences} preferences */
function writePreferences(preferences) {
  try {
    localStorage.setItem(STORAGE_KEY, JSON.stringify(preferences));
  } catch (error) {
    if (!(error instanceof DOMException)) throw error; // without storage they last as long as the page
  }
}
