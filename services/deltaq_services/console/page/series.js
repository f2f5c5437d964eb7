// Numbers over the last two minutes, kept in a ring.

export const SPAN_S = 120;
const STEP_S = 0.1;

export class Series {
  constructor() {
    this.size = Math.ceil(SPAN_S / STEP_S);
    this.times = new Float64Array(this.size);
    this.values = new Float64Array(this.size);
    this.count = 0;
  }

  /** Add a value at a time [s]; more than ten a second are left out. */
  add(time_s, value) {
    if (this.count && time_s - this.newest_s < STEP_S) return;
    this.times[this.count % this.size] = time_s;
    this.values[this.count % this.size] = value;
    this.count += 1;
  }

  get newest_s() {
    return this.count ? this.times[(this.count - 1) % this.size] : NaN;
  }

  get last() {
    return this.count ? this.values[(this.count - 1) % this.size] : NaN;
  }

  /** [time, value] from the oldest to the newest. */
  *[Symbol.iterator]() {
    for (let k = Math.max(0, this.count - this.size); k < this.count; k++) {
      yield [this.times[k % this.size], this.values[k % this.size]];
    }
  }

  /** Least and greatest finite value not older than `from_s`; null without any. */
  range(from_s) {
    let [least, most] = [Infinity, -Infinity];
    for (const [time, value] of this) {
      if (time < from_s || !Number.isFinite(value)) continue;
      least = Math.min(least, value);
      most = Math.max(most, value);
    }
    return least <= most ? [least, most] : null;
  }
}
