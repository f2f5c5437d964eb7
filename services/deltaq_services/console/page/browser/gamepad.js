// A gamepad in the browser: hold a shoulder button to move; unplugged or out of focus is rest.

import { HAND_M_S, HAND_RAD_S, speedOf } from "./jog.js";

export const DEAD = 0.12; // of a stick's way, in which it is at rest
const EXPO = 0.6; // share of the cube: fine near the middle, fast at the end
const PUSHED = 0.5; // of a stick's way, from which on it goes along a way
const PULLED = 0.5; // of a trigger's way
const OPTIONS = 9;
const SPEED_STEP = 0.1; // of full speed
const LOOK_MS = 30;
const FELT_MS = 100; // longer than to the next look, and over soon after the last

/** What a stick's way means: at rest in the dead zone, fine near it, 1 at the end. */
export function shaped(way) {
  const past = (Math.abs(way) - DEAD) / (1 - DEAD);
  if (!(past > 0)) return 0;
  const full = Math.min(1, past);
  return Math.sign(way) * ((1 - EXPO) * full + EXPO * full ** 3);
}

const isDown = (button) => !!button?.pressed && !(button.value <= PULLED); // a trigger is pressed before it is pulled

/** Whether what has that function in the layout is held. */
function holds(pad, layout, wanted) {
  return isDown(pad.buttons[layout.controls.find((control) => control.function === wanted).standard]);
}

/**
 * The wish of a pad: {element: speed}, {option: rank} of a way to go along, or null for none; sticks count only while a
 * shoulder button is held.
 * @param layout of scene.json; option the advisor's that is chosen.
 */
export function wishOf(pad, layout, driven, option) {
  const moves = holds(pad, layout, "move");
  if (!moves && !holds(pad, layout, "turn")) return null;
  const [lx, ly, , ry] = [0, 1, 2, 3].map((axis) => shaped(pad.axes[axis] ?? 0));
  if (driven.goesAlongWays) return ly < -PUSHED ? { option: driven.mode === "advisor" ? option : 1 } : {};
  if (driven.isByJoints) return { [driven.joint]: -ly * speedOf(driven, driven.joint) };
  const full = driven.share * (moves ? HAND_M_S : HAND_RAD_S);
  const from = moves ? 0 : 3;
  return { [from]: -ly * full, [from + 1]: -lx * full, [from + 2]: -ry * full };
}

/** Rumble for a moment, where the pad can: the less goes through, the more strongly. */
function feel(pad, strength) {
  if (!(strength > 0)) return;
  const felt = { duration: FELT_MS, strongMagnitude: strength, weakMagnitude: strength };
  pad.vibrationActuator?.playEffect("dual-rumble", felt).catch(() => {}); // a pad that cannot do this one
}

export class Gamepad {
  /**
   * @param layout of scene.json: which button does what.
   * @param actions what buttons do, each a function: mode, frame, robot, hand, picture, output(index, isOn), distance(change), stop.
   * @param goesThrough () => the fraction of the wish that is let through, for the hand to feel.
   */
  constructor(layout, driven, wish, actions, show, goesThrough) {
    Object.assign(this, { layout, driven, wish, actions, show, goesThrough, option: 1, output: 0, index: null });
    this._before = null;
    window.addEventListener("gamepadconnected", ({ gamepad }) => this._plugged(gamepad));
    window.addEventListener("gamepaddisconnected", ({ gamepad }) => gamepad.index === this.index && this._unplugged());
    for (const pad of navigator.getGamepads?.() ?? []) if (pad) this._plugged(pad);
  }

  _plugged(pad) {
    if (this.index !== null) return;
    this.index = pad.index;
    this._forget();
    this._timer = setInterval(() => this._look(), LOOK_MS);
  }

  /** What is held now was not meant for the robot: it has to be pressed anew. */
  _forget() {
    this._armed = false;
    this._before = null;
  }

  _unplugged() {
    clearInterval(this._timer);
    this.index = null;
    this.wish.release("gamepad");
    this.show(null);
  }

  _look() {
    const pad = navigator.getGamepads()[this.index];
    if (!pad?.connected) {
      this._unplugged();
      return;
    }
    this.show(pad, this);
    if (!document.hasFocus()) {
      this._forget();
      this.wish.release("gamepad");
      return;
    }
    const wish = wishOf(pad, this.layout, this.driven, this.option);
    if (!wish) this._armed = true;
    if (wish && this._armed && Object.values(wish).some((speed) => speed)) this._armed = this.wish.hold("gamepad", wish); // refused: to be pressed anew
    else this.wish.release("gamepad");
    if (wish && this._armed) feel(pad, 1 - this.goesThrough());
    this._press(pad);
  }

  /** Buttons act once, as they go down; a stop also as the first that is heard of the pad. */
  _press(pad) {
    const now = pad.buttons.map(isDown);
    for (const { standard, function: what } of this.layout.controls) {
      const isNew = this._before ? !this._before[standard] : what === "stop";
      if (now[standard] && isNew) this._act(what);
    }
    this._before = now;
  }

  _act(what) {
    const { actions, layout, driven } = this;
    const outputs = driven.scenery.outputs.length;
    const switches = (isOn) => outputs && actions.output(this.output % outputs, isOn);
    const acts = {
      mode: actions.mode, frame: actions.frame, hand: actions.hand, robot: actions.robot, picture: actions.picture, stop: actions.stop,
      on: () => switches(true),
      off: () => switches(false),
      output: () => (this.output = outputs ? (this.output + 1) % outputs : 0),
      nearer: () => actions.distance(-layout.view_step_m),
      farther: () => actions.distance(layout.view_step_m),
      previous: () => this._step(-1),
      next: () => this._step(1),
    };
    acts[what]?.();
  }

  /** The next of what one chooses among in this mode: options, joints, or the hand's speeds. */
  _step(step) {
    const { driven } = this;
    if (driven.mode === "advisor") this.option = ((this.option - 1 + step + OPTIONS) % OPTIONS) + 1;
    else if (driven.isByJoints) driven.chooseJoint((driven.joint + step + driven.length()) % driven.length());
    else driven.changeShare(step * SPEED_STEP);
  }
}
