// The transform between the sensor's plan frame (x right, y forward, metres) and the canvas (CSS pixels).

const SCALE_MIN = 0.4; // pixels per metre: a kilometre on a phone
const SCALE_MAX = 60;
const BEHIND_M = 6; // road shown behind the radar when the whole region is fitted
const BEYOND = 1.04; // and beyond its far end
const WIDTH_MIN_M = 60; // the road and its shoulders, whatever the shape of the canvas

/** Where the canvas looks; x and y below are plan metres, left and top are pixels. */
export class View {
  widthPx = 1;
  heightPx = 1;
  scale = 4; // pixels per metre
  xCentreM = 0;
  yCentreM = 75;

  /** @param {number} xM */
  left(xM) {
    return this.widthPx / 2 + (xM - this.xCentreM) * this.scale;
  }

  /** @param {number} yM */
  top(yM) {
    return this.heightPx / 2 - (yM - this.yCentreM) * this.scale;
  }

  /** @param {number} leftPx */
  xM(leftPx) {
    return this.xCentreM + (leftPx - this.widthPx / 2) / this.scale;
  }

  /** @param {number} topPx */
  yM(topPx) {
    return this.yCentreM - (topPx - this.heightPx / 2) / this.scale;
  }

  /** @param {{range_max_m: number}} region shown over its whole length; its sides only as far as they fit */
  fit(region) {
    const farM = region.range_max_m * BEYOND;
    this.scale = clamp(Math.min(this.heightPx / (farM + BEHIND_M), this.widthPx / WIDTH_MIN_M));
    this.xCentreM = 0;
    this.yCentreM = (farM - BEHIND_M) / 2;
  }

  /**
   * Zoom, and keep the place under a pixel where it is.
   * @param {number} factor
   * @param {number} leftPx
   * @param {number} topPx
   */
  zoom(factor, leftPx = this.widthPx / 2, topPx = this.heightPx / 2) {
    const [xM, yM] = [this.xM(leftPx), this.yM(topPx)];
    this.scale = clamp(this.scale * factor);
    this.xCentreM += xM - this.xM(leftPx);
    this.yCentreM += yM - this.yM(topPx);
  }

  /**
   * Move the picture by pixels.
   * @param {number} rightPx
   * @param {number} downPx
   */
  pan(rightPx, downPx) {
    this.xCentreM -= rightPx / this.scale;
    this.yCentreM += downPx / this.scale;
  }
}

/** @param {number} scale */
function clamp(scale) {
  return Math.min(Math.max(scale, SCALE_MIN), SCALE_MAX);
}
