// How often and how finely pictures are drawn: the next one begins when the last is finished, since the page hears nothing
// while a picture is waited for, not even a press of STOP; and as fine as can be drawn in time. What stands still is drawn
// once more as fine as the screen is.

// it is seen that a picture is finished when the screen wants the next one, every 17 ms
const SLOW_MS = 28;
const QUICK_MS = 19;
const COARSEST = 0.4;
const STILL_MS = 350;

export class Pace {
  /** @param gl WebGL 2; finest pixels of a picture to one of the page. */
  constructor(gl, finest, mayVary) {
    Object.assign(this, { gl, finest, mayVary, fineness: finest, _took_ms: 25, _begun: [], _lastAt: 0 });
  }

  /** Whether another picture can be begun. */
  isFree(now) {
    while (this._begun.length && this.gl.getSyncParameter(this._begun[0].fence, this.gl.SYNC_STATUS) === this.gl.SIGNALED) {
      const { fence, at } = this._begun.shift();
      this.gl.deleteSync(fence);
      this._took_ms += 0.2 * (Math.min(200, now - at) - this._took_ms);
    }
    return !this._begun.length;
  }

  /** A picture was begun at `now`. */
  begun(now) {
    this._lastAt = now;
    this._begun.push({ fence: this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0), at: now });
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
    return this.mayVary && now - this._lastAt > STILL_MS;
  }
}
