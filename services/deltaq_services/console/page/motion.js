// From frames, 25 a second, to pictures: robots glide from where they are shown to where the newest frame has them.

const GLIDE_MS = 45; // a frame's time and a little more
const SAME = 1e-6; // rad or m

export class Motion {
  /** @param views RobotView of each robot, in the order of the frames; stage Stage. */
  constructor(live, views, stage) {
    Object.assign(this, { views, stage });
    this._from = this._to = null;
    live.addEventListener("shown", ({ detail }) => this._take(detail));
    stage.beforeEach((now) => this._glide(now));
  }

  _take(frame) {
    this._from = this._to ? this.views.map((view) => view.q) : frame.robots.map(({ q }) => Array.from(q));
    this._to = frame.robots.map(({ q }) => Array.from(q));
    this._since = performance.now();
    this._isMoving = this._to.some((q, index) => q.some((value, k) => Math.abs(value - this.views[index].q[k]) > SAME));
  }

  _glide(now) {
    if (!this._isMoving) return;
    const share = Math.min(1, Math.max(0, (now - this._since) / GLIDE_MS));
    this.views.forEach((view, index) => {
      const [from, to] = [this._from[index], this._to[index]];
      view.place(to.map((value, k) => from[k] + share * (value - from[k])));
    });
    this._isMoving = share < 1;
    this.stage.ask(true);
  }
}
