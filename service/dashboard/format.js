// Turn numbers of the API into the words of the page. SI comes in; the unit is chosen here and nowhere else.

/** @typedef {"kmh" | "mps" | "mph"} Unit */

export const NONE = "–";

/** @type {Record<Unit, {factor: number, label: string}>} */
export const UNITS = {
  kmh: { factor: 3.6, label: "km/h" },
  mps: { factor: 1, label: "m/s" },
  mph: { factor: 3600 / 1609.344, label: "mph" },
};

const MINUTE_S = 60;
const HOUR_S = 3600;
const DAY_S = 86_400;

/**
 * @param {number | null | undefined} speedMps
 * @param {Unit} unit
 * @returns {string} the number alone; metres per second keep one decimal
 */
export function speedNumber(speedMps, unit) {
  if (speedMps == null) return NONE;
  return (speedMps * UNITS[unit].factor).toFixed(unit === "mps" ? 1 : 0);
}

/**
 * @param {number | null | undefined} speedMps
 * @param {Unit} unit
 */
export function speedText(speedMps, unit) {
  return speedMps == null ? NONE : `${speedNumber(speedMps, unit)} ${UNITS[unit].label}`;
}

/**
 * @param {number | null | undefined} value
 * @param {number} decimals
 * @param {string} [unit]
 */
export function numberText(value, decimals, unit = "") {
  if (value == null || !Number.isFinite(value)) return NONE;
  const text = value.toFixed(decimals);
  const plain = Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
  return unit ? `${plain} ${unit}` : plain;
}

/**
 * @param {number | null | undefined} durationS
 * @returns {string} such as "0.3 s", "45 s", "3 min", "5 h", "2 d"
 */
export function durationText(durationS) {
  if (durationS == null) return NONE;
  if (durationS < 10) return `${Math.max(durationS, 0).toFixed(1)} s`;
  if (durationS < 2 * MINUTE_S) return `${Math.round(durationS)} s`;
  if (durationS < 2 * HOUR_S) return `${Math.round(durationS / MINUTE_S)} min`;
  if (durationS < 2 * DAY_S) return `${Math.round(durationS / HOUR_S)} h`;
  return `${Math.round(durationS / DAY_S)} d`;
}

/** @param {number | null | undefined} bytes */
export function bytesText(bytes) {
  if (bytes == null) return NONE;
  const units = ["B", "kB", "MB", "GB", "TB"];
  let size = bytes;
  let step = 0;
  while (size >= 1000 && step < units.length - 1) {
    size /= 1000;
    step += 1;
  }
  return `${size.toFixed(step > 0 && size < 10 ? 1 : 0)} ${units[step]}`;
}

/**
 * @param {string} trackId such as "radar-1-1-37"
 * @returns {string} the number of the track inside its sensor and epoch, such as "37"
 */
export function shortId(trackId) {
  return trackId.slice(trackId.lastIndexOf("-") + 1);
}

/** @param {string | null | undefined} word */
export function wordText(word) {
  return word ? word[0].toUpperCase() + word.slice(1) : NONE;
}
