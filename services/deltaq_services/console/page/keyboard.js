// Driving by the keyboard: a key is a button that is held. STOP's Escape is in stop.js and works everywhere.

import { speedOf } from "./jog.js";

// key code: [element of the hand's wish, sign]; in joint modes a digit chooses the joint and the arrows move it
const HAND_KEYS = {
  KeyW: [0, 1], KeyS: [0, -1], KeyA: [1, 1], KeyD: [1, -1], KeyR: [2, 1], KeyF: [2, -1],
  KeyU: [3, 1], KeyO: [3, -1], KeyI: [4, 1], KeyK: [4, -1], KeyJ: [5, 1], KeyL: [5, -1],
};

function isTyping(target) {
  return target.matches?.("input[type=text], input[type=search], input[type=number], textarea, select");
}

export function driveByKeys(driven, wish, choose) {
  window.addEventListener("keydown", (event) => {
    if (event.repeat || event.ctrlKey || event.metaKey || event.altKey || isTyping(event.target)) return;
    const digit = /^Digit([1-9])$/.exec(event.code);
    if (event.code === "KeyM") choose.mode();
    else if (event.code === "KeyG") choose.robot();
    else if (event.code === "KeyV") choose.picture();
    else if (event.code === "KeyH") choose.hand();
    else if (event.code === "KeyC" && !driven.isByJoints) wish.hold("key KeyC", { led: true });
    else if (digit && driven.isByJoints) driven.chooseJoint(Number(digit[1]) - 1);
    else if (driven.isByJoints && ["ArrowUp", "ArrowDown"].includes(event.code)) {
      event.preventDefault();
      const sign = event.code === "ArrowUp" ? 1 : -1;
      wish.hold(`key ${event.code}`, { [driven.joint]: sign * speedOf(driven, driven.joint) });
    } else if (!driven.isByJoints && event.code in HAND_KEYS) {
      const [index, sign] = HAND_KEYS[event.code];
      wish.hold(`key ${event.code}`, { [index]: sign * speedOf(driven, index) });
    }
  });
  window.addEventListener("keyup", (event) => wish.release(`key ${event.code}`));
}
