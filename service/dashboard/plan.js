// The canvas: when it is drawn, in which order, and what a tap on it means.

import { listenForGestures } from "./gestures.js";
import { Labels } from "./labels.js";
import { drawLanes } from "./lanes.js";
import { drawDraft, drawScenery } from "./scenery.js";
import { readTheme } from "./theme.js";
import { Trails } from "./trails.js";
import { drawBox, drawEllipse, drawPoints, drawTrails, placed } from "./vehicles.js";
import { View } from "./view.js";

const FRAME_MS = 30; // some 30 pictures a second: smooth enough, and light work for a wall that runs all day
const AHEAD_MAX_S = 0.5; // vehicles move on by themselves no longer than this
const TAP_REACH_PX = 22;
const LINE_ENDS = 2;

/** Draws the road from above; what was drawn last stands in the data attributes of the canvas. */
export class Plan {
  #view = new View();
  #trails = new Trails();
  #labels = new Labels();
  #theme = readTheme();
  #still = matchMedia("(prefers-reduced-motion: reduce)");
  /** @type {string | null} */
  #sensorKey = null;
  /** @type {import("./vehicles.js").Drawn[]} */
  #drawn = [];
  #moved = false; // by hand: then a change of size leaves the view alone
  #dirty = true;
  #drawnAtMs = 0;
  #pixelRatio = 1;

  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import("./state.js").Store} store
   */
  constructor(canvas, store) {
    this.canvas = canvas;
    this.store = store;
    this.pen = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
    listenForGestures(canvas, {
      onPan: (rightPx, downPx) => this.#move(() => this.#view.pan(rightPx, downPx)),
      onZoom: (factor, leftPx, topPx) => this.zoom(factor, leftPx, topPx),
      onTap: (leftPx, topPx) => this.#tap(leftPx, topPx),
      onFit: () => this.fit(),
      onEscape: () => this.store.set({ selected: null, draft: null }),
    });
    new ResizeObserver(() => this.#resize()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.#theme = readTheme();
      this.#dirty = true;
    });
    store.subscribe(() => this.#changed());
    requestAnimationFrame((nowMs) => this.#tick(nowMs));
  }

  /** @param {import("./state.js").LiveView} view that has just come */
  take(view) {
    this.#trails.add(view.tracks, performance.now());
  }

  /** Show the whole region of the sensor. */
  fit() {
    const sensor = this.store.sensor;
    if (sensor !== null) this.#view.fit(sensor.region);
    this.#moved = false;
    this.#dirty = true;
  }

  /**
   * @param {number} factor
   * @param {number} [leftPx]
   * @param {number} [topPx]
   */
  zoom(factor, leftPx, topPx) {
    this.#move(() => this.#view.zoom(factor, leftPx, topPx));
  }

  /** @param {() => void} movement */
  #move(movement) {
    movement();
    this.#moved = true;
    this.#dirty = true;
  }

  #changed() {
    const sensor = this.store.sensor;
    const key = sensor && JSON.stringify([sensor.sensor_id, sensor.region]);
    if (key !== this.#sensorKey) {
      this.#sensorKey = key;
      this.#trails.clear();
      this.fit();
    }
    this.#dirty = true;
  }

  #resize() {
    this.#view.widthPx = this.canvas.clientWidth;
    this.#view.heightPx = this.canvas.clientHeight;
    this.#pixelRatio = devicePixelRatio || 1;
    this.canvas.width = Math.round(this.#view.widthPx * this.#pixelRatio);
    this.canvas.height = Math.round(this.#view.heightPx * this.#pixelRatio);
    if (!this.#moved) this.fit();
    this.#draw(performance.now());
  }

  /** @param {number} nowMs */
  #tick(nowMs) {
    requestAnimationFrame((next) => this.#tick(next));
    const moving = this.store.freshness === "live" && !this.#still.matches;
    if (!this.#dirty && !(moving && nowMs - this.#drawnAtMs >= FRAME_MS)) return;
    this.#draw(performance.now());
    this.#drawnAtMs = nowMs;
  }

  /** @param {number} nowMs */
  #draw(nowMs) {
    this.#dirty = false;
    const { live, preferences, selected, draft, lanes } = this.store.state;
    const [pen, view, theme] = [this.pen, this.#view, this.#theme];
    pen.setTransform(this.#pixelRatio, 0, 0, this.#pixelRatio, 0, 0);
    const names = drawScenery(pen, view, theme, this.store.sensor);
    const shownLanes = preferences.lanes ? lanes : [];
    drawLanes(pen, view, theme, shownLanes);
    if (draft !== null) drawDraft(pen, view, theme, draft);
    const aheadS = this.#aheadS();
    this.#drawn = (live?.tracks ?? []).map((track) => placed(view, track, aheadS, track.track_id === selected));
    const byId = new Map(this.#drawn.map((drawn) => [drawn.track.track_id, drawn]));
    const trails = preferences.trails ? this.#trails.recent(nowMs) : [];
    drawTrails(pen, view, theme, trails, byId, nowMs);
    const points = preferences.points && live?.points ? drawPoints(pen, view, theme, live.points) : 0;
    for (const drawn of this.#drawn) drawEllipse(pen, view, theme, drawn);
    for (const drawn of this.#drawn) drawBox(pen, theme, drawn);
    const labels = preferences.labels
      ? this.#labels.draw(pen, theme, this.#drawn, preferences.units, names)
      : 0;
    this.#tell({ tracks: this.#drawn.length, points, labels, trails: trails.length, lanes: shownLanes.length, version: live?.version ?? "" });
  }

  /** @returns {number} seconds by which the tracks are older than now, within reason */
  #aheadS() {
    if (this.#still.matches || this.store.freshness !== "live") return 0;
    return Math.min(this.store.ageS ?? 0, AHEAD_MAX_S);
  }

  /** @param {Record<string, number | string>} counts */
  #tell(counts) {
    for (const [name, value] of Object.entries(counts)) {
      if (this.canvas.dataset[name] !== String(value)) this.canvas.dataset[name] = String(value);
    }
    this.canvas.dataset.scale = this.#view.scale.toFixed(3);
    this.canvas.dataset.centre = `${this.#view.xCentreM.toFixed(2)} ${this.#view.yCentreM.toFixed(2)}`;
  }

  /**
   * Set an end of the count line that is being drawn, or select the vehicle there.
   * @param {number} leftPx
   * @param {number} topPx
   */
  #tap(leftPx, topPx) {
    const { draft } = this.store.state;
    if (draft === null) {
      this.#select(leftPx, topPx);
      return;
    }
    /** @type {[number, number]} */
    const end = [this.#view.xM(leftPx), this.#view.yM(topPx)];
    this.store.set({ draft: draft.length < LINE_ENDS ? [...draft, end] : [draft[0], end] });
  }

  /**
   * @param {number} leftPx
   * @param {number} topPx
   */
  #select(leftPx, topPx) {
    let nearest = null;
    let reachPx = TAP_REACH_PX;
    for (const drawn of this.#drawn) {
      const distancePx = Math.hypot(drawn.left - leftPx, drawn.top - topPx);
      if (distancePx > reachPx) continue;
      nearest = drawn.track.track_id;
      reachPx = distancePx;
    }
    this.store.set({ selected: nearest });
  }
}
