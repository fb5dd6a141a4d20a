// What to do while there is nothing to show: the exact next command.

import { serviceAddress } from "./api.js";

const DEMO_PORT = 8399; // this server has its own port; the demonstration needs another

/**
 * @param {boolean} keyed whether the server asks for a key
 * @returns {{title: string, steps: {text: string, command: string}[]}}
 */
function noSensor(keyed) {
  const address = serviceAddress();
  const key = keyed ? " --key ADMIN_KEY" : "";
  return {
    title: "No sensor yet",
    steps: [
      { text: "Register yours; its site file says how it is mounted:", command: `wayside sensor add site.json --url ${address}${key}` },
      {
        text: "or without a file:",
        command: `curl -X POST ${address}/api/v1/sensors${keyHeader(keyed, "ADMIN_KEY")} -H 'Content-Type: application/json' -d '{"sensor_id": "radar-1"}'`,
      },
      { text: "Only looking around? A simulated road, on another port:", command: `wayside demo --port ${DEMO_PORT}` },
    ],
  };
}

/**
 * @param {string} sensorId
 * @param {boolean} keyed
 */
function noFrame(sensorId, keyed) {
  const address = serviceAddress();
  const detections = '{"range_m": [41.2, 41.9], "azimuth_deg": [3.1, 3.4], "radial_velocity_mps": [-14.2, -14.1]}';
  const key = keyed ? " --key INGEST_KEY" : "";
  return {
    title: `Waiting for the first frame of ${sensorId}`,
    steps: [
      {
        text: "Post one by hand:",
        command:
          `curl -X POST ${address}/api/v1/sensors/${sensorId}/frames${keyHeader(keyed, "INGEST_KEY")}` +
          ` -H 'Content-Type: application/json'` +
          ` -d '{"timestamp": "'$(date -u +%FT%TZ)'", "detections": ${detections}}'`,
      },
      { text: "or play a recording:", command: `wayside replay frames.jsonl.gz --sensor ${sensorId} --url ${address}${key}` },
    ],
  };
}

/**
 * @param {boolean} keyed
 * @param {string} name
 */
function keyHeader(keyed, name) {
  return keyed ? ` -H 'Authorization: Bearer ${name}'` : "";
}

/** Fills the place over the canvas when there is no sensor, or none of its frames. */
export class EmptyState {
  #shown = "";

  /**
   * @param {HTMLElement} place
   * @param {import("./state.js").Store} store
   */
  constructor(place, store) {
    this.place = place;
    this.store = store;
    store.subscribe(() => this.#show());
  }

  #show() {
    const { access, sensors, sensorId } = this.store.state;
    const keyed = access === "session";
    let content = null;
    if (sensors?.length === 0) content = noSensor(keyed);
    else if (sensorId !== null && this.store.freshness === "waiting") content = noFrame(sensorId, keyed);
    this.place.hidden = content === null;
    const key = JSON.stringify(content);
    if (key === this.#shown) return;
    this.#shown = key;
    this.place.replaceChildren(...(content === null ? [] : elements(content)));
  }
}

/** @param {{title: string, steps: {text: string, command: string}[]}} content */
function elements({ title, steps }) {
  const heading = document.createElement("h3");
  heading.textContent = title;
  return [heading, ...steps.flatMap(({ text, command }) => [paragraph(text), commandBox(command)])];
}

/** @param {string} text */
function paragraph(text) {
  const element = document.createElement("p");
  element.textContent = text;
  return element;
}

/** @param {string} command */
function commandBox(command) {
  const box = document.createElement("div");
  box.className = "command";
  const [frame, code] = [document.createElement("pre"), document.createElement("code")];
  code.textContent = command;
  frame.tabIndex = 0; // it scrolls sideways
  frame.append(code);
  box.append(frame);
  if (navigator.clipboard) box.append(copyButton(command)); // not on plain http from elsewhere
  return box;
}

/** @param {string} command */
function copyButton(command) {
  const button = document.createElement("button");
  button.type = "button";
  button.textContent = "Copy";
  button.addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(command);
      button.textContent = "Copied";
    } catch (error) {
      if (!(error instanceof DOMException)) throw error;
      button.textContent = "Not allowed";
    }
  });
  return button;
}
