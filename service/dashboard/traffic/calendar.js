// Which hours are complete: a row for each day, a cell for each hour.

const HOUR_MS = 3_600_000;
const FULL = 0.98; // of the expected frames
const PARTIAL = 0.5;

/**
 * @param {number} coverage
 * @returns {"full" | "partial" | "poor" | "none"}
 */
export function levelOf(coverage) {
  if (coverage <= 0) return "none";
  if (coverage >= FULL) return "full";
  return coverage >= PARTIAL ? "partial" : "poor";
}

/**
 * Show the hours of the days from start to end, in the viewer's time.
 * @param {HTMLTableElement} table
 * @param {{start: string, end: string, coverage: number}[]} hours
 */
export function showCalendar(table, hours) {
  /** @type {Map<string, Map<number, number>>} */
  const days = new Map();
  for (const { start, coverage } of hours) {
    const at = new Date(start);
    const day = `${at.getFullYear()}-${twoDigits(at.getMonth() + 1)}-${twoDigits(at.getDate())}`;
    const known = days.get(day) ?? new Map();
    known.set(at.getHours(), Math.max(coverage, known.get(at.getHours()) ?? 0));
    days.set(day, known);
  }
  const head = document.createElement("tr");
  head.append(document.createElement("th"), ...Array.from({ length: 24 }, (_, hour) => heading(hour % 6 ? "" : twoDigits(hour))));
  const rows = [...days].reverse().map(([day, known]) => {
    const row = document.createElement("tr");
    row.append(heading(day));
    for (let hour = 0; hour < 24; hour += 1) row.append(cell(day, hour, known.get(hour)));
    return row;
  });
  table.replaceChildren(head, ...rows);
}

/**
 * @param {string} day
 * @param {number} hour
 * @param {number | undefined} coverage
 */
function cell(day, hour, coverage) {
  const made = document.createElement("td");
  const share = coverage ?? 0;
  made.dataset.level = levelOf(share);
  const text = share > 0 ? `${(share * 100).toFixed(0)} % of the frames` : "no frames";
  made.title = `${day} ${twoDigits(hour)}:00, ${text}`;
  made.setAttribute("aria-label", made.title);
  return made;
}

/** @param {string} text */
function heading(text) {
  const made = document.createElement("th");
  made.textContent = text;
  return made;
}

/** @param {number} value */
function twoDigits(value) {
  return String(value).padStart(2, "0");
}

export { HOUR_MS };
