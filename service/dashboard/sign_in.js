// Trade an API key for a session cookie that scripts cannot read, and give it back.

import { Problem, readJson, request } from "./api.js";

/** @typedef {{open: boolean, key_id: string | null, scopes: string[]}} Session */

/**
 * @param {Session} session
 * @returns {import("./state.js").State["access"]}
 */
function accessOf(session) {
  if (!session.scopes.includes("read")) return "signed-out";
  return session.open ? "open" : "session";
}

/** @returns {Promise<import("./state.js").State["access"]>} what this browser may do now */
export async function readAccess() {
  return accessOf(await readJson("api/v1/session"));
}

export async function signOut() {
  await request("api/v1/session", { method: "DELETE" });
}

/** The form that asks for the key. */
export class SignIn {
  /**
   * @param {HTMLFormElement} form
   * @param {import("./state.js").Store} store
   */
  constructor(form, store) {
    this.form = form;
    this.store = store;
    this.input = /** @type {HTMLInputElement} */ (form.querySelector("input"));
    this.error = /** @type {HTMLElement} */ (form.querySelector("[role=alert]"));
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      this.#submit();
    });
    store.subscribe(({ access }) => {
      const wanted = access === "signed-out";
      if (form.hidden !== wanted) return;
      form.hidden = !wanted;
      if (wanted) this.input.focus();
    });
  }

  async #submit() {
    this.error.hidden = true;
    try {
      const access = await this.#trade(this.input.value.trim());
      this.input.value = "";
      this.store.set({ access });
    } catch (error) {
      this.#tell(error instanceof Problem ? sentence(error.message) : "The server cannot be reached.");
    }
  }

  /**
   * @param {string} key
   * @returns {Promise<import("./state.js").State["access"]>}
   */
  async #trade(key) {
    const headers = { Authorization: `Bearer ${key}` };
    /** @type {Session} */
    const session = await readJson("api/v1/session", { method: "POST", headers });
    const access = accessOf(session);
    if (access === "signed-out") {
      await signOut();
      throw new Problem(403, "this key does not open the scope read");
    }
    return access;
  }

  /** @param {string} text */
  #tell(text) {
    this.error.textContent = text;
    this.error.hidden = false;
    this.input.select();
  }
}

/** @param {string} text */
function sentence(text) {
  return `${text[0].toUpperCase()}${text.slice(1)}.`;
}
