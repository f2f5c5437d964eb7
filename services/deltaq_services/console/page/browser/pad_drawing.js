// A drawing of the gamepad that says what does what, and lights up as it is pressed.

import { BUTTON } from "./gamepad.js";
import { el, say } from "./dom.js";

const ROUND = { y: [196, 40], b: [212, 56], a: [196, 72], x: [180, 56] };
const CROSS = { up: [64, 84, 12, 14], down: [64, 108, 12, 14], left: [50, 97, 14, 12], right: [76, 97, 14, 12] };
const LETTERS = { y: "mode", b: "STOP", a: "gripper", x: "picture", up: "view nearer", down: "view farther", left: "joint −", right: "joint +", back: "robot", start: "hand", lb: "hold: move", rb: "hold: turn" };

export function padDrawing(driven) {
  const lights = {};
  const light = (name, shape) => (lights[name] = shape);
  const sticks = [[60, 56], [152, 100]].map(([x, y]) => ({ x, y, dot: el("circle", { cx: x, cy: y, r: 11, class: "stick" }) }));
  const drawing = el("svg", { viewBox: "0 0 252 160", role: "img", "aria-label": "Gamepad: what its buttons do" },
    el("path", { class: "pad-body", d: "M66 22h120c26 0 44 20 52 66 6 36 2 58-16 58-20 0-24-32-46-32H76c-22 0-26 32-46 32-18 0-22-22-16-58 8-46 26-66 52-66z" }),
    light("lb", el("rect", { x: 40, y: 8, width: 52, height: 11, rx: 5 })),
    light("rb", el("rect", { x: 160, y: 8, width: 52, height: 11, rx: 5 })),
    light("back", el("rect", { x: 104, y: 52, width: 14, height: 8, rx: 4 })),
    light("start", el("rect", { x: 134, y: 52, width: 14, height: 8, rx: 4 })),
    ...Object.entries(CROSS).map(([name, [x, y, width, height]]) => light(name, el("rect", { x, y, width, height, rx: 3 }))),
    ...Object.entries(ROUND).flatMap(([name, [x, y]]) => [light(name, el("circle", { cx: x, cy: y, r: 9 })), el("text", { x, y: y + 3.5 }, name.toUpperCase())]),
    ...sticks.flatMap(({ x, y, dot }) => [el("circle", { cx: x, cy: y, r: 15, class: "well" }), dot]),
  );
  const words = el("p", { class: "pad-words" });
  const list = el("dl", {}, ...Object.entries(LETTERS).flatMap(([name, what]) => [el("dt", {}, name.toUpperCase()), el("dd", {}, what)]));
  const box = el("section", { class: "pad" }, el("h2", {}, "Gamepad"), drawing, words, list);

  function show(pad, gamepad) {
    box.dataset.plugged = String(!!pad);
    if (!pad) {
      say(words, "No gamepad. Press one of its buttons.");
      return;
    }
    for (const [name, shape] of Object.entries(lights)) shape.toggleAttribute("data-lit", !!pad.buttons[BUTTON[name]]?.pressed);
    sticks.forEach(({ x, y, dot }, index) => {
      dot.setAttribute("cx", x + 7 * (pad.axes[2 * index] ?? 0));
      dot.setAttribute("cy", y + 7 * (pad.axes[2 * index + 1] ?? 0));
    });
    say(words, driven.isByJoints ? `Left stick: ${driven.scenery.joints[gamepad.joint]?.name.toUpperCase()}` : "Sticks: the hand, while a shoulder button is held");
  }
  show(null);
  return { box, show };
}
