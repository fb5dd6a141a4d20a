// Put the parts of the page together: who may look, which sensor, and what comes in.

import { Problem, readSensors } from "./api.js";
import { CountLines } from "./count_lines.js";
import { Details } from "./details.js";
import { EmptyState } from "./empty.js";
import { speedNumber, UNITS } from "./format.js";
import { Health } from "./health.js";
import { LaneMap } from "./lanes.js";
import { LivePoll } from "./live.js";
import { Plan } from "./plan.js";
import { readAccess, SignIn, signOut } from "./sign_in.js";
import { Store } from "./state.js";
import { Status } from "./status.js";
import { TrackTable } from "./table.js";
import { SPEED_STOPS_MPS } from "./theme.js";

const SENSORS_PERIOD_MS = 10_000;
const SENSORS_EAGER_MS = 1500; // while there is none to show
const ZOOM_STEP = 1.4;

/**
 * @template {HTMLElement} [T=HTMLElement]
 * @param {string} id
 * @returns {T}
 */
function part(id) {
  const element = document.getElementById(id);
  if (element === null) throw new Error(`the page has no ${id}`);
  return /** @type {T} */ (element);
}

const store = new Store();
const plan = new Plan(part("plan"), store);
const poll = new LivePoll({
  onView: (live) => {
    plan.take(live);
    store.set({ live, liveAtMs: performance.now() });
  },
  onContact: () => {
    if (store.state.failingSinceMs !== null) store.set({ failingSinceMs: null });
  },
  onFailure: (error) => fail(error),
});

/** @param {Error} error */
function fail(error) {
  const status = error instanceof Problem ? error.status : 0;
  if (status === 401 || status === 403) {
    store.set({ access: "signed-out" });
  } else if (status === 404) {
    choose(null); // the next look at the sensors finds another
  } else if (store.state.failingSinceMs === null) {
    store.set({ failingSinceMs: performance.now() });
  }
}

/** @param {string | null} sensorId */
function choose(sensorId) {
  store.set({ sensorId, live: null, selected: null, draft: null, failingSinceMs: null });
  poll.follow(sensorId);
}

/** Ask which sensors there are; the one that is shown stays as long as it exists. */
async function refreshSensors() {
  if (document.hidden) return;
  try {
    if (store.state.access === "starting") {
      store.set({ access: await readAccess() }); // and `followAccess` comes back
      return;
    }
    if (store.state.access === "signed-out") return;
    const sensors = await readSensors();
    store.set({ sensors });
    if (store.state.sensorId === null) store.set({ failingSinceMs: null });
    const ids = sensors.map((sensor) => sensor.sensor_id);
    const { sensorId, preferences } = store.state;
    if (sensorId !== null && ids.includes(sensorId)) return;
    choose(ids.find((id) => id === preferences.sensorId) ?? ids[0] ?? null);
  } catch (error) {
    fail(/** @type {Error} */ (error));
  }
}

async function keepLooking() {
  await refreshSensors();
  setTimeout(keepLooking, store.state.sensorId === null ? SENSORS_EAGER_MS : SENSORS_PERIOD_MS);
}

function showSensors() {
  const picker = /** @type {HTMLSelectElement} */ (part("sensor"));
  const { sensors, sensorId } = store.state;
  const wanted = (sensors ?? []).map(({ sensor_id: id, name }) => ({ id, text: name === id ? id : `${name} (${id})` }));
  const key = JSON.stringify(wanted);
  if (picker.dataset.key !== key) {
    picker.dataset.key = key;
    picker.replaceChildren(...wanted.map(({ id, text }) => new Option(text, id)));
    part("sensor-field").hidden = wanted.length === 0;
  }
  if (sensorId !== null && picker.value !== sensorId) picker.value = sensorId;
}

function showCount() {
  const { live } = store.state;
  const count = String(live?.tracks.length ?? 0);
  if (part("track-count").textContent !== count) part("track-count").textContent = count;
  part("no-tracks").hidden = count !== "0";
}

function showLegend() {
  const { units } = store.state.preferences;
  const [slow, medium, fast] = SPEED_STOPS_MPS.map((speedMps) => speedNumber(speedMps, units));
  part("legend-slow").textContent = slow;
  part("legend-medium").textContent = medium;
  part("legend-fast").textContent = `${fast}+ ${UNITS[units].label}`;
}

function showAccess() {
  const { access } = store.state;
  part("main").hidden = access === "signed-out";
  part("sign-out").hidden = access !== "session";
  if (access === "signed-out") part("sensor-field").hidden = true;
}

/** @param {"labels" | "trails" | "points" | "lanes"} name */
function bindSwitch(name) {
  const box = /** @type {HTMLInputElement} */ (part(`show-${name}`));
  box.checked = store.state.preferences[name];
  box.addEventListener("change", () => store.prefer({ [name]: box.checked }));
}

function bindControls() {
  bindSwitch("labels");
  bindSwitch("trails");
  bindSwitch("points");
  bindSwitch("lanes");
  const units = /** @type {HTMLSelectElement} */ (part("units"));
  units.value = store.state.preferences.units;
  units.addEventListener("change", () => {
    store.prefer({ units: /** @type {import("./format.js").Unit} */ (units.value) });
  });
  const sensor = /** @type {HTMLSelectElement} */ (part("sensor"));
  sensor.addEventListener("change", () => {
    const chosen = sensor.value; // a change of the state puts the picker back to the sensor shown
    store.prefer({ sensorId: chosen });
    choose(chosen);
  });
  part("fit").addEventListener("click", () => plan.fit());
  part("zoom-in").addEventListener("click", () => plan.zoom(ZOOM_STEP));
  part("zoom-out").addEventListener("click", () => plan.zoom(1 / ZOOM_STEP));
  part("sign-out").addEventListener("click", async () => {
    try {
      await signOut();
      store.set({ access: "signed-out" });
    } catch (error) {
      fail(/** @type {Error} */ (error));
    }
  });
}

/** Start when somebody has come in, stop when they have left. */
function followAccess() {
  let before = store.state.access;
  store.subscribe(({ access }) => {
    if (access === before) return;
    before = access;
    if (access === "signed-out") {
      poll.follow(null);
      store.set({ sensors: null, sensorId: null, live: null, selected: null, failingSinceMs: null });
    } else if (access !== "starting") {
      refreshSensors();
    }
  });
}

bindControls();
followAccess();
new TrackTable(part("tracks"), store);
new LaneMap(store);
new Details(part("details"), store);
new CountLines(part("lines"), store);
new Health({ list: part("health"), failure: part("failure"), version: part("version") }, store);
new EmptyState(part("empty"), store);
new Status(
  { state: part("state"), banner: part("banner"), age: part("banner-age"), picture: part("main") },
  store,
);
new SignIn(part("sign-in"), store);
store.subscribe((state) => {
  poll.points = state.preferences.points;
  showSensors();
  showCount();
  showLegend();
  showAccess();
});
store.set({});
document.addEventListener("visibilitychange", refreshSensors);
keepLooking();
