// Which of several cameras is shown: the present one for as long as it sees its target, then the first that does.

export const UNSEEN_MS = 1000; // a glance away does not hand over

export class Handover {
  constructor() {
    Object.assign(this, { present: 0, _lost_ms: null });
  }

  /**
   * The place of the camera to be shown.
   * @param seen of each camera, whether it sees its target; now in ms.
   */
  choose(seen, now) {
    if (seen[this.present]) {
      this._lost_ms = null;
      return this.present;
    }
    this._lost_ms ??= now;
    const next = seen.indexOf(true);
    if (next >= 0 && now - this._lost_ms >= UNSEEN_MS) this.take(next);
    return this.present;
  }

  /** Another camera is shown from now on. */
  take(place) {
    Object.assign(this, { present: place, _lost_ms: null });
  }
}
