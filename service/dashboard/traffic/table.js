// Fill plain tables: a heading for each column, a row for each record.

/**
 * @template T
 * @typedef {object} Column
 * @property {string} name
 * @property {(record: T) => string | HTMLElement} value
 * @property {boolean} [word] text, not a number
 * @property {string} [hint]
 */

/**
 * @template T
 * @param {HTMLTableElement} table with a head row and a body
 * @param {Column<T>[]} columns
 * @param {T[]} records
 */
export function fillTable(table, columns, records) {
  const head = /** @type {HTMLElement} */ (table.tHead?.rows[0]);
  head.replaceChildren(
    ...columns.map(({ name, word, hint }) => {
      const cell = document.createElement("th");
      cell.scope = "col";
      cell.textContent = name;
      cell.classList.toggle("word", Boolean(word));
      if (hint) cell.title = hint;
      return cell;
    }),
  );
  const rows = records.map((record) => {
    const row = document.createElement("tr");
    for (const { value, word } of columns) {
      const cell = row.insertCell();
      cell.append(value(record));
      cell.classList.toggle("word", Boolean(word));
    }
    return row;
  });
  table.tBodies[0].replaceChildren(...rows);
}

/**
 * @param {string} text
 * @param {string} label what it does, for who cannot see where it stands
 * @param {() => void} act
 * @returns {HTMLButtonElement}
 */
export function newButton(text, label, act) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = text;
  button.setAttribute("aria-label", label);
  button.addEventListener("click", act);
  return button;
}
