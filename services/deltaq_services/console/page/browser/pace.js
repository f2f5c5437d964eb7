// How often and how finely pictures are drawn: one at a time, so that a slow machine's page still hears and obeys, and
// as fine as it can be drawn in time. What stands still is drawn once more as fine as the screen is.

const SLOW_MS = 34;
const QUICK_MS = 15;
const COARSEST = 0.5;
const STILL_MS = 350;

export class Pace {
  /** @param gl WebGL 2; finest pixels of a picture to one of the page. */
  constructor(gl, finest, mayVary) {
    Object.assign(this, { gl, finest, mayVary, fineness: finest, _took_ms: 25, _fence: null, _lastAt: 0 });
  }

  /** Whether the last picture is done, so that the next one can be begun. */
  isFree(now) {
    if (!this._fence) return true;
    if (this.gl.getSyncParameter(this._fence, this.gl.SYNC_STATUS) !== this.gl.SIGNALED) return false;
    this.gl.deleteSync(this._fence);
    this._fence = null;
    this._took_ms += 0.2 * (Math.min(200, now - this._begunAt) - this._took_ms);
    return true;
  }

  /** A picture was begun at `now`. */
  begun(now) {
    this._begunAt = this._lastAt = now;
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
    return this.mayVary && now - this._lastAt > STILL_MS;
  }
}
