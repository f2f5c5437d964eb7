// A gamepad in the browser: hold a shoulder button to move; unplugged or out of focus is rest.

import { HAND_M_S, HAND_RAD_S, speedOf } from "./jog.js";

export const DEAD = 0.12; // of a stick's way, in which it is at rest
const EXPO = 0.6; // share of the cube: fine near the middle, fast at the end
const VIEW_M_S = 0.5; // change of the view distance by the triggers' pad

// places of the standard mapping
export const BUTTON = { a: 0, b: 1, x: 2, y: 3, lb: 4, rb: 5, lt: 6, rt: 7, back: 8, start: 9, up: 12, down: 13, left: 14, right: 15 };

/** What a stick's way means: at rest in the dead zone, fine near it, 1 at the end. */
export function shaped(way) {
  const past = (Math.abs(way) - DEAD) / (1 - DEAD);
  if (!(past > 0)) return 0;
  const full = Math.min(1, past);
  return Math.sign(way) * ((1 - EXPO) * full + EXPO * full ** 3);
}

/** The wish of a pad: {element: speed}, or null for none; sticks count only while a shoulder button is held. */
export function wishOf(pad, driven, joint) {
  if (!pad.buttons[BUTTON.lb]?.pressed && !pad.buttons[BUTTON.rb]?.pressed) return null;
  const [lx, ly, rx, ry] = [0, 1, 2, 3].map((axis) => shaped(pad.axes[axis] ?? 0));
  if (driven.isByJoints) return { [joint]: -ly * speedOf(driven, joint) };
  const turns = !pad.buttons[BUTTON.lb]?.pressed; // right shoulder: turn, left: move
  const full = driven.share * (turns ? HAND_RAD_S : HAND_M_S);
  const from = turns ? 3 : 0;
  return { [from]: -ly * full, [from + 1]: -lx * full, [from + 2]: -(ry || rx) * full };
}

export class Gamepad {
  /** @param actions what buttons do: {mode, robot, hand, gripper, picture, distance, stop}, each a function. */
  constructor(driven, wish, actions, show) {
    Object.assign(this, { driven, wish, actions, show, joint: 0, index: null });
    this._before = [];
    window.addEventListener("gamepadconnected", ({ gamepad }) => this._plugged(gamepad));
    window.addEventListener("gamepaddisconnected", ({ gamepad }) => gamepad.index === this.index && this._unplugged());
    for (const pad of navigator.getGamepads?.() ?? []) if (pad) this._plugged(pad);
  }

  _plugged(pad) {
    if (this.index !== null) return;
    this.index = pad.index;
    this._armed = false; // what is held as it is plugged in has to be pressed anew
    this._timer = setInterval(() => this._look(), 30);
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
      this._armed = false;
      this.wish.release("gamepad");
      return;
    }
    const wish = wishOf(pad, this.driven, this.joint);
    if (!wish) this._armed = true;
    if (wish && this._armed && Object.values(wish).some((speed) => speed)) this.wish.hold("gamepad", wish);
    else this.wish.release("gamepad");
    this._press(pad);
  }

  /** Buttons act once, as they go down. */
  _press(pad) {
    const isDown = pad.buttons.map((button) => button.pressed);
    const pressed = (name) => isDown[BUTTON[name]] && !this._before[BUTTON[name]];
    if (pressed("y")) this.actions.mode();
    if (pressed("a")) this.actions.gripper();
    if (pressed("x")) this.actions.picture();
    if (pressed("back")) this.actions.robot();
    if (pressed("start")) this.actions.hand();
    if (pressed("up")) this.actions.distance(-VIEW_M_S / 5);
    if (pressed("down")) this.actions.distance(VIEW_M_S / 5);
    const last = this.driven.scenery.joints.length - 1;
    if (pressed("left")) this.joint = Math.max(0, this.joint - 1);
    if (pressed("right")) this.joint = Math.min(last, this.joint + 1);
    if (pressed("b")) this.actions.stop();
    this._before = isDown;
  }
}
