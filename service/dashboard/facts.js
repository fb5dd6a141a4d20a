// Write pairs of a name and a value into a description list, changing only what changed.

/** @typedef {{name: string, value: string, hint?: string, bad?: boolean}} Fact */

/**
 * @param {HTMLElement} list a `dl`
 * @param {Fact[]} facts the same names in the same order each time, or the list is built anew
 */
export function showFacts(list, facts) {
  const names = facts.map((fact) => fact.name).join("\n");
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...facts.map(newFact));
  }
  facts.forEach((fact, i) => {
    const value = /** @type {HTMLElement} */ (list.children[i].lastElementChild);
    if (value.textContent !== fact.value) value.textContent = fact.value;
    value.classList.toggle("bad", Boolean(fact.bad));
  });
}

/** @param {Fact} fact */
function newFact(fact) {
  const group = document.createElement("div");
  const [name, value] = [document.createElement("dt"), document.createElement("dd")];
  name.textContent = fact.name;
  if (fact.hint) group.title = fact.hint;
  group.append(name, value);
  return group;
}
