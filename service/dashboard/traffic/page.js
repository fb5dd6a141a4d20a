// Put the page of traffic together: which sensor and period, and what is shown of it.

import { Problem, readSensors } from "../api.js";
import { UNITS } from "../format.js";
import { Store } from "../state.js";
import { Chart, columnsOf, inOrder, laneKey } from "./charts.js";
import { HOUR_MS, showCalendar } from "./calendar.js";
import { Checks } from "./checks.js";
import { ended, flowPath, readCoverage, readFlow, readLanes, readNewestMs, readStates } from "./data.js";
import { Evidence } from "./evidence.js";
import { showMeasures } from "./measures.js";
import { drawDiagram, pathsOf } from "./timespace.js";

const REFRESH_MS = 15_000;
const DIAGRAM_MS = 120_000; // of states: more would be a grey surface
const CALENDAR_DAYS = 14;
const PERIODS = [
  { name: "One hour, by minute", lengthMs: HOUR_MS, interval: "1min", stepMs: 60_000 },
  { name: "6 hours, by 5 minutes", lengthMs: 6 * HOUR_MS, interval: "5min", stepMs: 300_000 },
  { name: "One day, by 15 minutes", lengthMs: 24 * HOUR_MS, interval: "15min", stepMs: 900_000 },
  { name: "One week, by hour", lengthMs: 168 * HOUR_MS, interval: "60min", stepMs: HOUR_MS },
];

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
const picker = /** @type {HTMLSelectElement} */ (part("sensor"));
const periodPicker = /** @type {HTMLSelectElement} */ (part("period"));
const linePicker = /** @type {HTMLSelectElement} */ (part("line"));
const lanePicker = /** @type {HTMLSelectElement} */ (part("diagram-lane"));
const unitPicker = /** @type {HTMLSelectElement} */ (part("units"));
const evidence = new Evidence(part("evidence"));
const volume = new Chart(part("volume"), (startMs) => choose(startMs));
const speed = new Chart(part("speed"), (startMs) => choose(startMs));
const checks = new Checks(
  { table: part("checks"), form: part("check-form"), start: part("check-start"), count: part("check-count"), failure: part("check-failure") },
  () => ({ sensorId: store.state.sensorId, lineId: linePicker.value || null }),
);

/** @type {import("./data.js").FlowRow[]} */
let rows = [];
/** @type {import("./data.js").Lane[]} */
let lanes = [];
/** @type {import("./data.js").StateLine[]} */
let states = [];
/** @type {number | null} */
let endMs = null; // of the period; null: the newest frame
/** @type {number | null} */
let chosenMs = null; // start of the interval in the table; null: the newest
let newestMs = Date.now(); // of the sensor's frames: a recording may be of last year
let asked = 0; // counts the questions, so that a late answer to an old one is dropped

function period() {
  return PERIODS[periodPicker.selectedIndex] ?? PERIODS[0];
}

/** @returns {import("./data.js").Window} */
function windowOf() {
  const { lengthMs, stepMs, interval } = period();
  const end = Math.ceil(((endMs ?? newestMs) + 1) / stepMs) * stepMs;
  return { startMs: end - lengthMs, endMs: end, interval };
}

async function refresh() {
  const { sensorId } = store.state;
  if (sensorId === null || document.hidden) return;
  asked += 1;
  const turn = asked;
  try {
    newestMs = (await readNewestMs(sensorId)) ?? Date.now();
    const window = windowOf();
    const untilMs = Math.min(endMs ?? newestMs, newestMs) + 1;
    const days = { startMs: window.endMs - CALENDAR_DAYS * 24 * HOUR_MS, endMs: window.endMs, interval: "60min" };
    const diagram = { startMs: untilMs - DIAGRAM_MS, endMs: untilMs, interval: "" };
    const [flow, hours, map, lines] = await Promise.all([
      readFlow(sensorId, window),
      readCoverage(sensorId, days),
      readLanes(sensorId),
      readStates(sensorId, diagram),
    ]);
    if (turn !== asked) return;
    // A sensor that fell silent, or a recording, is behind the clock: its last interval has ended, too.
    [rows, lanes, states] = [ended(flow, Math.max(newestMs, Date.now())), map, lines];
    tell("");
    showWindow(window, rows.length < flow.length);
    showLines();
    showLanes();
    showFlow(window);
    showCalendar(part("calendar"), hours);
    showDiagram(diagram);
    await checks.refresh();
  } catch (error) {
    fail(/** @type {Error} */ (error));
  }
}

/** @param {Error} error */
function fail(error) {
  if (!(error instanceof Problem)) tell("The server cannot be reached. Trying again.");
  else if (error.status === 401 || error.status === 403) tell("Sign in on the page Live, with a key of scope read.");
  else tell(`The server answered: ${error.message}.`);
}

/** @param {string} text */
function tell(text) {
  const banner = part("banner");
  if (banner.textContent !== text) banner.textContent = text;
  /** @type {HTMLElement} */ (banner.parentElement).hidden = text === "";
}

/**
 * @param {import("./data.js").Window} window
 * @param {boolean} oneRuns whether an interval that has not ended is left out
 */
function showWindow(window, oneRuns) {
  const [from, to] = [window.startMs, window.endMs].map((atMs) => new Date(atMs).toLocaleString());
  const leftOut = oneRuns ? "; the interval that has not ended is left out" : "";
  part("window").textContent = `${from} to ${to}, in the time of this browser${leftOut}`;
  const { sensorId } = store.state;
  if (sensorId === null) return;
  const lineId = linePicker.value || null;
  part("as-csv").setAttribute("href", flowPath(sensorId, window, lineId, "csv"));
  part("as-json").setAttribute("href", flowPath(sensorId, window, lineId, "json"));
  part("as-pems").setAttribute("href", flowPath(sensorId, window, lineId, "pems"));
}

/** Keep the choice of line when the lines are still there. */
function showLines() {
  const drawn = store.sensor?.count_lines.map(({ line_id: id }) => id) ?? [];
  offer(linePicker, [...new Set([...drawn, ...rows.map((row) => row.line_id)])].sort().map((id) => ({ value: id, text: id })));
}

function showLanes() {
  const known = lanes.map((lane) => ({ value: lane.lane_id, text: lane.name ? `${lane.lane_id} (${lane.name})` : lane.lane_id }));
  offer(lanePicker, [{ value: "", text: "all, by distance ahead" }, ...known]);
}

/**
 * @param {HTMLSelectElement} select
 * @param {{value: string, text: string}[]} options
 */
function offer(select, options) {
  const key = JSON.stringify(options);
  if (select.dataset.key === key) return;
  const before = select.value;
  select.dataset.key = key;
  select.replaceChildren(...options.map(({ value, text }) => new Option(text, value)));
  if (options.some(({ value }) => value === before)) select.value = before;
}

/** @param {import("./data.js").Window} window */
function showFlow(window) {
  const { units } = store.state.preferences;
  const shown = rows.filter((row) => row.line_id === linePicker.value);
  const keys = inOrder([...new Set(shown.map(laneKey))]);
  const factor = UNITS[units].factor;
  part("speed-unit").textContent = UNITS[units].label;
  volume.show(columnsOf(shown, keys, (row) => row.flow_vph), keys, window, true);
  speed.show(
    columnsOf(shown, keys, (row) => (row.space_mean_speed_mps === null ? null : row.space_mean_speed_mps * factor)),
    keys,
    window,
    false,
  );
  showInterval(shown);
}

/** @param {import("./data.js").FlowRow[]} shown */
function showInterval(shown) {
  const starts = [...new Set(shown.map((row) => row.start))].sort();
  const wanted = starts.find((start) => Date.parse(start) === chosenMs) ?? starts.at(-1);
  const order = inOrder(shown.map(laneKey));
  const mine = shown.filter((row) => row.start === wanted).sort((a, b) => order.indexOf(laneKey(a)) - order.indexOf(laneKey(b)));
  part("measures-of").textContent = wanted === undefined ? "" : `from ${new Date(wanted).toLocaleString()}`;
  part("measures-none").hidden = mine.length > 0;
  showMeasures(part("measures"), mine, store.state.preferences.units, async (row) => {
    try {
      await evidence.open(/** @type {string} */ (store.state.sensorId), row, store.state.preferences.units);
    } catch (error) {
      fail(/** @type {Error} */ (error));
    }
  });
}

/** @param {number} startMs of an interval that was clicked */
function choose(startMs) {
  chosenMs = startMs;
  showInterval(rows.filter((row) => row.line_id === linePicker.value));
}

/** @param {{startMs: number, endMs: number}} window */
function showDiagram(window) {
  const lane = lanes.find((known) => known.lane_id === lanePicker.value) ?? null;
  part("diagram-of").textContent = `the last ${DIAGRAM_MS / 60_000} minutes; the way ${lane === null ? "ahead of the radar" : "along the lane"} over time`;
  drawDiagram(part("diagram"), pathsOf(states, lane), window);
}

/** @param {number} periods to move by; 0: to the newest */
function move(periods) {
  const { lengthMs } = period();
  endMs = periods === 0 ? null : (endMs ?? newestMs) + periods * lengthMs;
  if (endMs !== null && endMs >= newestMs) endMs = null;
  chosenMs = null;
  refresh();
}

async function begin() {
  try {
    const sensors = await readSensors();
    store.set({ sensors });
    offer(picker, sensors.map(({ sensor_id: id, name }) => ({ value: id, text: name === id ? id : `${name} (${id})` })));
    const preferred = store.state.preferences.sensorId;
    if (store.state.sensorId === null && sensors.some(({ sensor_id: id }) => id === preferred)) picker.value = /** @type {string} */ (preferred);
    store.set({ sensorId: picker.value || null });
    if (picker.value === "") tell("There is no sensor yet: the page Live shows how to make one.");
    else await refresh();
  } catch (error) {
    fail(/** @type {Error} */ (error));
  }
  setTimeout(begin, REFRESH_MS);
}

periodPicker.replaceChildren(...PERIODS.map(({ name }) => new Option(name)));
unitPicker.value = store.state.preferences.units;
picker.addEventListener("change", () => {
  [endMs, chosenMs] = [null, null];
  store.prefer({ sensorId: picker.value });
  store.set({ sensorId: picker.value });
  refresh();
});
for (const select of [periodPicker, linePicker, lanePicker]) {
  select.addEventListener("change", () => {
    chosenMs = null;
    refresh();
  });
}
unitPicker.addEventListener("change", () => {
  store.prefer({ units: /** @type {import("../format.js").Unit} */ (unitPicker.value) });
  refresh();
});
part("earlier").addEventListener("click", () => move(-1));
part("later").addEventListener("click", () => move(1));
part("newest").addEventListener("click", () => move(0));
document.addEventListener("visibilitychange", refresh);
begin();
