// Buttons that move a robot while they are held: one pair a joint, or a pair for each axis of the hand.

import { el, jointText, say } from "./dom.js";
import { holds } from "./hold.js";

export const HAND_M_S = 0.25; // of the hand at full speed
export const HAND_RAD_S = 0.6;
const JOINT_SHARE = 0.25; // of a joint's greatest speed

const AXES = [
  ["X", "x"], ["Y", "y"], ["Z", "z"], ["turn X", "x"], ["turn Y", "y"], ["turn Z", "z"], // three beside three
];

/** Speed of one element of the wish at the chosen share [rad/s or m/s]. */
export function speedOf(driven, index) {
  if (!driven.isByJoints) return driven.share * (index < 3 ? HAND_M_S : HAND_RAD_S);
  return driven.share * JOINT_SHARE * driven.scenery.joints[index].max_speed;
}

/** By how much one press moves in steps: 1° or 5 mm, as [rad or m]. */
function stepOf(driven, index) {
  const turns = driven.isByJoints ? driven.scenery.joints[index].unit === "rad" : index >= 3;
  return turns ? Math.PI / 180 : 0.005;
}

export function jogPad(live, driven, wish) {
  const how = el("div", { class: "frames", role: "radiogroup", "aria-label": "What a press does" },
    ...[[false, "hold"], [true, "1°, 5 mm"]].map(([bySteps, title]) => el("button", {
      role: "radio", "data-steps": String(bySteps), title: bySteps ? "each press moves once, by 1° or 5 mm" : "moves while it is held", onclick: () => driven.chooseSteps(bySteps),
    }, title)));
  const pad = el("div", { class: "jog" });
  const why = el("p", { class: "why place", role: "status" });
  const rows = el("div", { class: "jog-rows" });
  pad.append(rows, how, why);
  let shown = "";
  let values = [];

  function pair(index, title, axis, value) {
    const buttons = [-1, 1].map((sign) => {
      const button = el("button", { class: "hold", "data-what": `${title} ${sign < 0 ? "minus" : "plus"}` }, sign < 0 ? "−" : "+");
      const source = `pad ${index} ${sign}`;
      holds(button, () => {
        if (!driven.bySteps) return wish.hold(source, { [index]: sign * speedOf(driven, index) });
        wish.step(index, sign * stepOf(driven, index));
        return false;
      }, () => wish.release(source));
      return button;
    });
    const row = el("div", { class: "jog-row", "data-axis": axis }, buttons[0], el("span", {}, el("b", {}, title), value), buttons[1]);
    rows.append(row);
  }

  function build() {
    const { name, isByJoints, scenery } = driven;
    const key = `${name} ${isByJoints}`;
    if (key === shown) return;
    shown = key;
    wish.releaseAll();
    rows.replaceChildren();
    rows.dataset.axes = String(!isByJoints);
    values = [];
    if (isByJoints) {
      scenery.joints.forEach((joint, index) => {
        values.push(el("small"));
        pair(index, joint.name.toUpperCase(), "", values[index]);
      });
    } else {
      AXES.forEach(([title, axis], index) => pair(index, title, axis, null));
    }
  }

  function show() {
    build();
    if (driven.isByJoints) [...rows.children].forEach((row, index) => row.toggleAttribute("data-chosen", index === driven.joint));
    const cannot = live.cannotDrive(driven.name);
    pad.dataset.locked = String(!!cannot);
    for (const button of rows.querySelectorAll("button")) {
      button.disabled = !!cannot;
      button.ariaLabel = `${button.dataset.what}, ${driven.bySteps ? "press to step" : "hold to move"}`;
    }
    for (const button of how.children) button.setAttribute("aria-checked", String(button.dataset.steps === String(driven.bySteps)));
    say(why, cannot ? `Locked: ${cannot}.` : wish.refused ? wish.refused : driven.bySteps ? "Each press moves once." : driven.isByJoints ? "Hold to move. Keys 1 to 9 choose a joint, ↑ ↓ move it." : "Hold to move.");
    const q = live.frame?.robots[live.indexOf(driven.name)]?.q;
    if (q) values.forEach((value, index) => say(value, jointText(q[index], driven.scenery.joints[index].unit)));
  }
  setInterval(show, 150);
  driven.addEventListener("change", show);
  show();
  return pad;
}

