// Turn pointers, wheel and keys on the canvas into movements of the view.

const TAP_PX = 6; // a pointer that moved less has tapped
const WHEEL_ZOOM = 0.0015; // per pixel of the wheel
const WHEEL_LINE_PX = 16;
const KEY_PAN_PX = 60;
const KEY_ZOOM = 1.25;

/**
 * @typedef {object} Listener
 * @property {(rightPx: number, downPx: number) => void} onPan
 * @property {(factor: number, leftPx?: number, topPx?: number) => void} onZoom
 * @property {(leftPx: number, topPx: number) => void} onTap
 * @property {() => void} onFit
 * @property {() => void} onEscape
 */

/**
 * @param {HTMLCanvasElement} canvas
 * @param {Listener} listener
 */
export function listenForGestures(canvas, listener) {
  listenForPointers(canvas, listener);
  canvas.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const deltaPx = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? event.deltaY * WHEEL_LINE_PX : event.deltaY;
      listener.onZoom(Math.exp(-deltaPx * WHEEL_ZOOM), event.offsetX, event.offsetY);
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const act = KEYS[event.key];
    if (!act) return;
    event.preventDefault();
    act(listener);
  });
}

/** @type {Record<string, (listener: Listener) => void>} */
const KEYS = {
  ArrowLeft: (listener) => listener.onPan(KEY_PAN_PX, 0),
  ArrowRight: (listener) => listener.onPan(-KEY_PAN_PX, 0),
  ArrowUp: (listener) => listener.onPan(0, KEY_PAN_PX),
  ArrowDown: (listener) => listener.onPan(0, -KEY_PAN_PX),
  "+": (listener) => listener.onZoom(KEY_ZOOM),
  "=": (listener) => listener.onZoom(KEY_ZOOM),
  "-": (listener) => listener.onZoom(1 / KEY_ZOOM),
  0: (listener) => listener.onFit(),
  Escape: (listener) => listener.onEscape(),
};

/**
 * One pointer drags, two pinch; a short touch taps.
 * @param {HTMLCanvasElement} canvas
 * @param {Listener} listener
 */
function listenForPointers(canvas, listener) {
  /** @type {Map<number, {left: number, top: number}>} */
  const down = new Map();
  let movedPx = 0;

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    if (down.size === 0) movedPx = 0;
    down.set(event.pointerId, { left: event.offsetX, top: event.offsetY });
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const now = { left: event.offsetX, top: event.offsetY };
    movedPx += Math.hypot(now.left - before.left, now.top - before.top);
    const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
    down.set(event.pointerId, now);
    if (other) {
      pinch(listener, before, now, other);
    } else if (movedPx > TAP_PX) {
      listener.onPan(now.left - before.left, now.top - before.top);
    }
  });
  const release = (/** @type {PointerEvent} */ event) => {
    const known = down.delete(event.pointerId);
    if (known && down.size === 0 && event.type === "pointerup" && movedPx <= TAP_PX) {
      listener.onTap(event.offsetX, event.offsetY);
    }
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
}

/**
 * @param {Listener} listener
 * @param {{left: number, top: number}} before
 * @param {{left: number, top: number}} now
 * @param {{left: number, top: number}} other the finger that rests
 */
function pinch(listener, before, now, other) {
  const beforePx = Math.hypot(before.left - other.left, before.top - other.top);
  const nowPx = Math.hypot(now.left - other.left, now.top - other.top);
  const middle = { left: (now.left + other.left) / 2, top: (now.top + other.top) / 2 };
  listener.onPan((now.left - before.left) / 2, (now.top - before.top) / 2);
  if (beforePx > 0) listener.onZoom(nowPx / beforePx, middle.left, middle.top);
}
