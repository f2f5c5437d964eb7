// STOP: on pointer-down and on Escape, repeated until the console has heard it, and answered only as far as is known. It
// outlives the page: one that is loaded anew, as after the console was started again, goes on repeating it.

import { remember, remembered } from "./dom.js";

const AGAIN_MS = 100;
const GIVE_UP_MS = 10000;
const CONFIRMED_MS = 1000; // later the operator has to do something else

// when it was pressed, for this tab's next page
const KEPT = "stop_pressed_ms";
const keepPressed = (time_ms) => remember(KEPT, time_ms, "sessionStorage");
const keptPressed = () => remembered(KEPT, 0, "sessionStorage");

const WORDS = {
  ready: ["STOP", "Esc · software stop, no safety-rated E-stop"],
  sending: ["STOP", "sending …"],
  not_sent: ["NOT SENT", "no connection: use the emergency stop"],
  asked: ["STOP", "asked: waiting for the gate"],
  not_confirmed: ["NOT CONFIRMED", "use the emergency stop · still asking"],
  stopping: ["STOPPING", "the gate has latched it"],
  at_rest: ["STOPPED", "every robot is at rest"],
};

const CONFIRMED = ["stopping", "at_rest"];

export class Stop {
  /**
   * @param live Live.
   * @param show called with (state, title, text) whenever what is known changes.
   */
  constructor(live, show) {
    Object.assign(this, { live, show, state: "ready", pressed: false, _unsure_ms: null });
    live.addEventListener("status", () => this.update());
    live.addEventListener("line", () => this.update());
    const pressed_ms = keptPressed();
    if (Date.now() - pressed_ms < GIVE_UP_MS) this._repeat(pressed_ms);
    this.update();
  }

  /** Somebody wants everything to stop. */
  press() {
    keepPressed(Date.now());
    this._repeat(Date.now());
  }

  _repeat(pressed_ms) {
    this._since_ms = pressed_ms;
    this.pressed = true;
    clearInterval(this._timer);
    this._timer = setInterval(() => this._send(), AGAIN_MS);
    this._send();
  }

  update() {
    const { isUp } = this.live.connection;
    const told = isUp ? this.live.status?.stop : undefined; // nothing is known before the first status
    let state = "ready";
    if (this.pressed) state = isUp ? "sending" : "not_sent";
    else if (!isUp && this.gaveUp) state = "not_sent";
    else if (told && told !== "none") state = told;
    else if (this._heard || (!told && this._unsure_ms !== null)) state = "asked";
    this.state = this._inTime(state);
    this.show(this.state, ...WORDS[this.state]);
  }

  /** The state, or that nothing has confirmed the stop for too long. */
  _inTime(state) {
    clearTimeout(this._late);
    if (state === "ready" || CONFIRMED.includes(state)) this._unsure_ms = null;
    else this._unsure_ms ??= Date.now();
    if (!["sending", "asked"].includes(state)) return state;
    const left_ms = this._unsure_ms + CONFIRMED_MS - Date.now();
    if (left_ms <= 0) return "not_confirmed";
    this._late = setTimeout(() => this.update(), left_ms);
    return state;
  }

  _send() {
    if (Date.now() - this._since_ms > GIVE_UP_MS) {
      this._end();
      this.gaveUp = true;
      this.update();
      return;
    }
    this.gaveUp = false;
    // each repetition is a command of its own, sent now: none waits for a line that is down
    this.live.send("stop").then(({ outcome }) => {
      if (outcome !== "asked" && outcome !== "done") return;
      this._end();
      this._heard = true;
      this.update();
      setTimeout(() => {
        this._heard = false; // from here on the status says how far it is
        this.update();
      }, 1000);
    });
    this.update();
  }

  _end() {
    clearInterval(this._timer);
    keepPressed(0);
    this.pressed = false;
  }
}

/** Let a button and the Escape key press it, whatever has the focus. */
export function bindStop(stop, button) {
  button.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    stop.press();
  });
  // keyboards and switches that make a click without a pointer
  button.addEventListener("click", (event) => event.detail === 0 && stop.press());
  window.addEventListener(
    "keydown",
    (event) => {
      if (event.key !== "Escape" || event.repeat) return;
      event.stopImmediatePropagation();
      stop.press();
    },
    { capture: true },
  );
}
