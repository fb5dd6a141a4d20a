// The one place that talks to the server. Paths are relative to the page, so a proxy may add a prefix.

const REQUEST_TIMEOUT_MS = 6000;

/** A reply that is no success, with what the problem body (RFC 9457) says. */
export class Problem extends Error {
  /**
   * @param {number} status
   * @param {string} detail
   */
  constructor(status, detail) {
    super(detail);
    this.name = "Problem";
    this.status = status;
  }
}

/**
 * @typedef {object} RequestOptions
 * @property {string} [method]
 * @property {Record<string, string>} [headers]
 * @property {string} [body]
 * @property {AbortSignal} [signal]
 * @property {number} [waitMs] how long the server may hold the request on purpose
 */

/** @returns {string} the address of the service, without a slash at the end */
export function serviceAddress() {
  return new URL(".", document.baseURI).href.replace(/\/$/, "");
}

/**
 * Ask the server; 304 is a reply like others.
 * @param {string} path relative to the page
 * @param {RequestOptions} [options]
 * @returns {Promise<Response>}
 * @throws {Problem} on a status of 400 or more; a TypeError or DOMException when there is no reply
 */
export async function request(path, { method = "GET", headers = {}, body, signal, waitMs = 0 } = {}) {
  const limit = AbortSignal.timeout(REQUEST_TIMEOUT_MS + waitMs);
  const response = await fetch(new URL(path, document.baseURI), {
    method,
    headers: { Accept: "application/json", ...headers },
    body,
    credentials: "same-origin",
    cache: "no-store",
    signal: signal ? AbortSignal.any([signal, limit]) : limit,
  });
  if (response.status >= 400) throw new Problem(response.status, await problemDetail(response));
  return response;
}

/**
 * @param {string} path
 * @param {RequestOptions} [options]
 * @returns {Promise<any>} the body, parsed
 */
export async function readJson(path, options) {
  return (await request(path, options)).json();
}

/**
 * @typedef {object} LiveQuery
 * @property {boolean} points
 * @property {number | null} after version to wait beyond; null: answer at once
 * @property {number} waitS
 * @property {string | null} etag
 * @property {AbortSignal} signal
 */

/**
 * Ask for the newest tracks of a sensor.
 * @param {string} sensorId
 * @param {LiveQuery} query
 * @returns {Promise<{etag: string | null, view: import("./state.js").LiveView | null}>} view null: nothing new
 */
export async function readLive(sensorId, { points, after, waitS, etag, signal }) {
  const query = new URLSearchParams();
  if (points) query.set("points", "true");
  if (after !== null) {
    query.set("after", String(after));
    query.set("wait", String(waitS));
  }
  const response = await request(`api/v1/sensors/${encodeURIComponent(sensorId)}/live?${query}`, {
    headers: etag ? { "If-None-Match": etag } : {},
    signal,
    waitMs: waitS * 1000,
  });
  const tag = response.headers.get("ETag");
  return { etag: tag, view: response.status === 304 ? null : await response.json() };
}

/**
 * @returns {Promise<import("./state.js").Sensor[]>} every sensor, over all pages
 */
export async function readSensors() {
  const sensors = [];
  let cursor = null;
  do {
    const query = cursor === null ? "" : `?${new URLSearchParams({ cursor })}`;
    const page = await readJson(`api/v1/sensors${query}`);
    sensors.push(...page.items);
    cursor = page.next;
  } while (cursor !== null);
  return sensors;
}

/**
 * Change a sensor by a JSON merge patch; needs the scope admin.
 * @param {string} sensorId
 * @param {Record<string, unknown>} patch
 * @returns {Promise<import("./state.js").Sensor>} the sensor as it is now
 */
export async function patchSensor(sensorId, patch) {
  return readJson(`api/v1/sensors/${encodeURIComponent(sensorId)}`, {
    method: "PATCH",
    headers: { "Content-Type": "application/merge-patch+json" },
    body: JSON.stringify(patch),
  });
}

/** @param {Response} response */
async function problemDetail(response) {
  const kind = response.headers.get("Content-Type") ?? "";
  if (!kind.includes("json")) return `the server answered ${response.status}`;
  const body = await response.json();
  return body.detail ?? body.title ?? `the server answered ${response.status}`;
}
