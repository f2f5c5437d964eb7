// A gamepad in the browser: hold a shoulder button to move; unplugged or out of focus is rest.

import { HAND_M_S, HAND_RAD_S, speedOf } from "./jog.js";

const DEAD = 0.12; // of a stick's way, in which it is at rest
const EXPO = 0.6; // share of the cube: fine near the middle, fast at the end
const PUSHED = 0.5; // of a stick's way, from which on it goes along a way
const PULLED = 0.5; // of a trigger's way
const OPTIONS = 9;
const SPEED_STEP = 0.1; // of full speed
const LOOK_MS = 30;
const FELT_MS = 100; // longer than to the next look, and over soon after the last
const STANDARD = { axes: 4, buttons: 16 }; // at least, of a pad that the browser maps (W3C, Gamepad, section 12)

// Pads that browsers leave unmapped, by maker and product. Each driver counts axes its own way, so their number belongs to the id.
// `sticks` are the axes of the left and the right stick; `buttons` are in the standard order: the number of a button, or
// [axis, its value at rest, its value when pressed] of what reports as an axis. Sources: the Linux kernel's xpad.rst; SDL's database
// of game controllers, entries 046d:c216 (Linux) and 054c:09cc (macOS).
const KNOWN = [
  {
    ids: ["045e:028e", "045e:02d1", "045e:02dd", "045e:02ea"], axes: 8, sticks: [0, 1, 3, 4],
    buttons: [0, 1, 2, 3, 4, 5, [2, -1, 1], [5, -1, 1], 6, 7, 9, 10, [7, 0, -1], [7, 0, 1], [6, 0, -1], [6, 0, 1]],
  },
  {
    ids: ["046d:c216"], axes: 6, sticks: [0, 1, 2, 3],
    buttons: [1, 2, 0, 3, 4, 5, 6, 7, 8, 9, 10, 11, [5, 0, -1], [5, 0, 1], [4, 0, -1], [4, 0, 1]],
  },
  { ids: ["054c:05c4", "054c:09cc"], axes: 6, sticks: [0, 1, 2, 5], buttons: [1, 2, 0, 3, 4, 5, [3, -1, 1], [4, -1, 1], 8, 9, 10, 11] },
];

/** "maker:product" of a pad, four hexadecimal digits each, as either kind of browser writes its id; empty if it has none. */
function productOf(id = "") {
  const [, maker, product] = /Vendor: ([\da-f]{4}) Product: ([\da-f]{4})/i.exec(id) ?? /^([\da-f]{1,4})-([\da-f]{1,4})-/i.exec(id) ?? [];
  return maker ? `${maker.padStart(4, "0")}:${product.padStart(4, "0")}`.toLowerCase() : "";
}

/** A pad's axes and buttons in the standard order, and where each axis rests; null if its layout is not known. */
function standardOf(pad) {
  const { axes, buttons } = pad;
  if (pad.mapping === "standard" && axes.length >= STANDARD.axes && buttons.length >= STANDARD.buttons) return { axes, buttons, rests: axes.map(() => 0) };
  const known = KNOWN.find((one) => one.ids.includes(productOf(pad.id)) && one.axes === axes.length);
  if (!known || buttons.length <= Math.max(...known.buttons.filter(Number.isInteger))) return null;
  const rests = axes.map((_, axis) => known.buttons.find((one) => one[0] === axis)?.[1] ?? 0);
  const asButton = ([axis, rest, end]) => {
    const value = Math.min(1, Math.max(0, (axes[axis] - rest) / (end - rest)));
    return { pressed: value > PULLED, value };
  };
  return { axes: known.sticks.map((axis) => axes[axis]), buttons: known.buttons.map((one) => (Array.isArray(one) ? asButton(one) : buttons[one])), rests };
}

/** What a stick's way means: at rest in the dead zone, fine near it, 1 at the end. */
export function shaped(way) {
  const past = (Math.abs(way) - DEAD) / (1 - DEAD);
  if (!(past > 0)) return 0;
  const full = Math.min(1, past);
  return Math.sign(way) * ((1 - EXPO) * full + EXPO * full ** 3);
}

const isDown = (button) => !!button?.pressed && !(button.value <= PULLED); // a trigger is pressed before it is pulled

/** Whether what has that function in the layout is held. */
function holds(standard, layout, wanted) {
  return isDown(standard.buttons[layout.controls.find((control) => control.function === wanted).standard]);
}

/**
 * The wish of a pad: {element: speed}, {option: rank} of a way to go along, or null for none; sticks count only while a
 * shoulder button is held. A pad whose layout is not known has none.
 * @param layout of scene.json; option the advisor's that is chosen.
 */
export function wishOf(pad, layout, driven, option) {
  const standard = standardOf(pad);
  const moves = standard && holds(standard, layout, "move");
  if (!moves && !(standard && holds(standard, layout, "turn"))) return null;
  const [lx, ly, , ry] = standard.axes.map(shaped);
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
   * @param show called with (pad, its standardOf, this) at each look; with null while there is none.
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
    const present = navigator.getGamepads()[this.index];
    if (present && standardOf(present)) return;
    clearInterval(this._timer);
    this.index = pad.index;
    this._stirred = null;
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
    const standard = standardOf(pad);
    this._arm(pad, standard);
    this.show(pad, standard, this);
    if (!standard) return;
    if (!document.hasFocus()) {
      this._forget();
      this.wish.release("gamepad");
      return;
    }
    const wish = wishOf(pad, this.layout, this.driven, this.option);
    if (!wish && !this._stirred.size) this._armed = true;
    if (wish && this._armed && Object.values(wish).some((speed) => speed)) this._armed = this.wish.hold("gamepad", wish); // refused: to be pressed anew
    else this.wish.release("gamepad");
    if (wish && this._armed) feel(pad, 1 - this.goesThrough());
    this._press(standard.buttons.map(isDown));
  }

  /** Nothing but STOP counts until each axis has been seen at rest since the pad was plugged in. A trigger that tells exactly 0 has not told yet. */
  _arm(pad, standard) {
    this._stirred ??= new Set(pad.axes.keys());
    for (const axis of this._stirred) if (standard && (!pad.axes[axis] || Math.abs(pad.axes[axis] - standard.rests[axis]) <= DEAD)) this._stirred.delete(axis);
  }

  /** What has to be let go before the pad counts, in words; empty once it does. */
  waitsFor(pad) {
    return [...this._stirred].map((axis) => `axis ${axis} stands at ${pad.axes[axis].toFixed(2)}`).join(", ");
  }

  /** Buttons act once, as they go down; a stop also as the first that is heard of the pad. */
  _press(now) {
    for (const { standard: place, function: what } of this.layout.controls) {
      const isNew = this._before ? !this._before[place] : what === "stop";
      if (now[place] && isNew && (what === "stop" || !this._stirred.size)) this._act(what);
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
