// How often and how finely pictures are drawn. Where the processor draws, the next one begins when the last is finished, no
// oftener than is seen, and as fine as can be drawn in time. What stands still is drawn once more as fine as the screen is.

const SLOW_MS = 27;
const QUICK_MS = 21;
const LEAST_MS = 27; // between the beginnings of two pictures: what the processor has left is the robots'
const COARSEST = 0.4;
const STILL_MS = 350;

export class Pace {
  /** @param gl WebGL 2; finest pixels of a picture to one of the page; mayVary where the processor draws. */
  constructor(gl, finest, mayVary) {
    Object.assign(this, { gl, finest, mayVary, fineness: finest, _took_ms: 25, _fence: null, _begunAt: -Infinity });
  }

  /** Whether the last picture is finished. */
  isFinished(now) {
    if (!this._fence) return true;
    // of a picture that was lost with the graphics hardware there is no status
    if (this.gl.getSyncParameter(this._fence, this.gl.SYNC_STATUS) === this.gl.UNSIGNALED) return false;
    this.gl.deleteSync(this._fence);
    this._fence = null;
    this._took_ms += 0.2 * (Math.min(200, now - this._begunAt) - this._took_ms);
    return true;
  }

  /** Whether it is time for another picture, once the last is finished. */
  isDue(now) {
    return !this.mayVary || now - this._begunAt >= LEAST_MS;
  }

  /** A picture was begun at `now`. */
  begun(now) {
    this._begunAt = now;
    this._fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.gl.flush();
  }

  /** How fine the next picture of something that moves is to be. */
  next() {
    if (!this.mayVary) return this.finest;
    if (this._took_ms > SLOW_MS) this.fineness = Math.max(COARSEST * this.finest, this.fineness - 0.1);
    else if (this._took_ms < QUICK_MS) this.fineness = Math.min(this.finest, this.fineness + 0.05);
    return Math.round(this.fineness * 10) / 10;
  }

  /** Whether nothing has been drawn for so long that a finer picture is worth it. */
  isStill(now) {
    return this.mayVary && now - this._begunAt > STILL_MS;
  }
}

// What is seen of pictures that the processor draws. A browser without graphics hardware fetches a canvas of WebGL while it is
// being drawn; the page waits for it and hears nothing meanwhile, not even a press of STOP. So that canvas is not on the
// page: what was drawn is copied to this one when it is finished.

export class Screen {
  /** @param drawn canvas of WebGL, which is not on the page and preserves what was drawn. */
  constructor(drawn) {
    this._drawn = drawn;
    this.canvas = document.createElement("canvas");
    this._pen = this.canvas.getContext("2d", { alpha: false });
    this._kept = null;
  }

  /** Whether the next picture to be shown is as fine as the one that is, so that parts of this may be kept. */
  get maySkip() {
    return this.canvas.width === this._drawn.width && this.canvas.height === this._drawn.height;
  }

  /** Let a part of the page as it is when the next picture is shown: [x, y, width, height] in its pixels, from below. */
  keep(part) {
    this._kept = part;
  }

  /** Show what was drawn; to be called when it is finished. */
  show() {
    const { canvas, _drawn: { width, height }, _pen: pen } = this;
    const kept = this.maySkip ? this._kept : null;
    if (!this.maySkip) Object.assign(canvas, { width, height });
    pen.save();
    if (kept) {
      const [x, y, wide, high] = kept;
      pen.beginPath();
      pen.rect(0, 0, width, height);
      pen.rect(x, height - y - high, wide, high);
      pen.clip("evenodd");
    }
    pen.drawImage(this._drawn, 0, 0);
    pen.restore();
    this._kept = null;
  }
}
