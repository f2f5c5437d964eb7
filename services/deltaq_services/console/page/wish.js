// Hold to move: while a button, a key or a stick is held, its wish is sent again and again; when it is let go, or the
// page loses the focus, one wish for rest is sent and nothing more.

const TOLD_MS = 3000; // a refusal is shown for so long
const STEP_S = 0.5;
const AGAIN_MS = 80; // the driver forgets a wish after 250 ms

export class Wish {
  /**
   * @param live Live.
   * @param target {robot(): name, length(): number of elements, hand(): name or ""} of what is driven now.
   */
  constructor(live, target) {
    Object.assign(this, { live, target, refused: "" });
    this._held = new Map();
    window.addEventListener("blur", () => this.releaseAll());
    document.addEventListener("visibilitychange", () => document.hidden && this.releaseAll());
    live.addEventListener("line", () => this.releaseAll());
    live.addEventListener("status", () => this._robot && this.live.cannotDrive(this._robot) && this.releaseAll());
    this._timer = setInterval(() => this._send(), AGAIN_MS);
  }

  get isActive() {
    return this._held.size > 0;
  }

  /** `source` wants to move so; parts are {index: speed [rad/s or m/s]}, {option: rank} to go along that way, or {led: true}. */
  hold(source, parts) {
    const name = this.target.robot();
    this._refuse(this._cannot(name, parts.option === undefined));
    if (this.refused) return false;
    if (this._robot && this._robot !== name) this.releaseAll();
    const begins = !this._held.size;
    this._robot = name;
    this._held.set(source, parts);
    if (begins) this._send();
    return true;
  }

  /** Move once by so much [rad or m] along one element, slowly: the robot ends it by itself. */
  step(index, size) {
    const name = this.target.robot();
    this._refuse(this._cannot(name, true));
    if (!this.refused && performance.now() < (this._stepsUntil ?? 0)) this._refuse("the last step is not finished: one at a time");
    if (this.refused || this.isActive) return;
    this._stepsUntil = performance.now() + 1000 * STEP_S;
    const cycle_s = this.live.scene.cycle_s;
    const cycles = Math.round(STEP_S / cycle_s);
    const wish = new Array(this.target.length()).fill(0);
    wish[index] = size / (cycles * cycle_s);
    this._robot = name;
    this._put({ wish, cycles });
    this._robot = null;
  }

  release(source) {
    if (!this._held.delete(source)) return;
    if (this._held.size) this._send();
    else this._rest();
  }

  /** Let everything go; it has to be pressed anew. */
  releaseAll() {
    if (!this._held.size) return;
    this._held.clear();
    this._rest();
  }

  _cannot(name, isJog) {
    return this.live.cannotDrive(name) || (isJog && this.target.jogs?.() === false ? "choose another mode to move it by hand" : "");
  }

  /** Why the last wish came to nothing, in words, for a while. */
  _refuse(text) {
    this.refused = text;
    clearTimeout(this._forget);
    if (text) this._forget = setTimeout(() => (this.refused = ""), TOLD_MS);
  }

  /** What is held, as a jog has it: a way, the master's lead, or the sum of all speeds. */
  _sum() {
    for (const { option } of this._held.values()) if (option !== undefined) return { option };
    for (const { led } of this._held.values()) if (led) return { led };
    const wish = new Array(this.target.length()).fill(0);
    for (const parts of this._held.values()) {
      for (const [index, speed] of Object.entries(parts)) wish[index] += speed;
    }
    return { wish };
  }

  _send() {
    if (!this._held.size) return;
    if (this.live.cannotDrive(this._robot)) {
      this.releaseAll();
      return;
    }
    this._put(this._sum());
  }

  _rest() {
    this._put({ wish: new Array(this.target.length()).fill(0) });
    this._robot = null;
  }

  _put(wanted) {
    if (!this._robot) return;
    const hand = (wanted.wish || wanted.led) && this.target.hand();
    this.live.send("jog", { robot: this._robot, ...wanted, ...(hand ? { hand } : {}) }).then((ack) => {
      if (ack.outcome !== "done") this._refuse(ack.text);
    });
  }
}
