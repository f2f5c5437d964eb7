// A drawing of the gamepad that says what does what, and lights up as it is pressed.

import { el, say } from "./dom.js";

// part of the layout: [x, y, width, height, what is written on it]; a round one has a radius alone
const PARTS = {
  left_trigger: [44, 3, 42, 15, "LT"], right_trigger: [214, 3, 42, 15, "RT"],
  left_shoulder: [40, 22, 46, 14, "LB"], right_shoulder: [214, 22, 46, 14, "RB"],
  back: [124, 62, 20, 11, "⧉"], start: [156, 62, 20, 11, "≡"],
  up: [91, 100, 16, 15, "▴"], down: [91, 130, 16, 15, "▾"], left: [75, 115, 16, 15, "◂"], right: [107, 115, 16, 15, "▸"],
  y: [226, 54, 10, null, "Y"], x: [206, 74, 10, null, "X"], b: [246, 74, 10, null, "B"], a: [226, 94, 10, null, "A"],
};
const STICKS = [["left_stick", 74, 76], ["right_stick", 196, 122]];
const STOP_PLACE = "the right one of the four round buttons";
const NAMES = { left_stick: "L press", back: "⧉ back", start: "≡ start", up: "▴", down: "▾", left: "◂", right: "▸" };

/** @param layout of scene.json. */
export function padDrawing(layout, driven) {
  const words = Object.fromEntries(layout.controls.map((control) => [control.name, control.words]));
  const functions = Object.fromEntries(layout.controls.map((control) => [control.name, control.function]));
  const shapes = {};
  const shapeOf = ([name, [x, y, width, height, text]]) => {
    const shape = height ? el("rect", { x, y, width, height, rx: 4 }) : el("circle", { cx: x, cy: y, r: width });
    shapes[name] = shape;
    const [cx, cy] = height ? [x + width / 2, y + height / 2] : [x, y];
    return el("g", { "data-function": functions[name] }, el("title", {}, words[name]), shape, el("text", { x: cx, y: cy + 3.2 }, text));
  };
  const sticks = STICKS.map(([name, x, y]) => ({ x, y, name, dot: el("circle", { cx: x, cy: y, r: 13, class: "stick" }) }));
  shapes.left_stick = sticks[0].dot;
  const beside = (x, y, name, anchor) => el("text", { x, y, class: "told", style: `text-anchor: ${anchor}` }, words[name]);
  const drawing = el("svg", { viewBox: "0 0 300 190", role: "img", "aria-label": `Gamepad: ${layout.controls.map(({ name, words: what }) => `${name.replaceAll("_", " ")} ${what}`).join(", ")}` },
    el("path", { class: "pad-body", d: "M76 40h148c30 0 50 24 60 80 6 42 2 66-18 66-24 0-30-36-54-36H88c-24 0-30 36-54 36-20 0-24-24-18-66 10-56 30-80 60-80z" }),
    ...Object.entries(PARTS).map(shapeOf),
    ...sticks.flatMap(({ x, y, dot }) => [el("circle", { cx: x, cy: y, r: 18, class: "well" }), dot]),
    beside(91, 14, "left_trigger", "start"), beside(209, 14, "right_trigger", "end"),
    beside(91, 33, "left_shoulder", "start"), beside(209, 33, "right_shoulder", "end"),
  );
  const doing = el("p", { class: "pad-words" });
  const listed = layout.controls.filter(({ name }) => !/shoulder|trigger/.test(name)); // those are told in the drawing
  const list = el("dl", {}, ...listed.flatMap(({ name, words: what }) => [el("dt", {}, NAMES[name] ?? name.toUpperCase()), el("dd", {}, what)]));
  const box = el("section", { class: "pad" }, el("h2", {}, "Gamepad"), drawing, doing, list);

  function sticksWords(gamepad) {
    if (driven.mode === "advisor") return `Left stick forward: to option ${gamepad.option}`;
    if (driven.mode === "pose") return "Left stick forward: to the pose";
    if (driven.isByJoints) return `Left stick: ${driven.scenery.joints[driven.joint].name.toUpperCase()}`;
    return "Left stick x, y; right stick z";
  }

  function show(pad, standard, gamepad) {
    box.dataset.plugged = String(!!standard);
    if (!standard) {
      say(doing, pad ? `${pad.id}: not used, because its layout is unknown. Its buttons do nothing, STOP included: press Esc, or STOP on the page. Another browser may know it.` : "No gamepad. Connect one and press one of its buttons.");
      return;
    }
    for (const { name, standard: place } of layout.controls) shapes[name].toggleAttribute("data-lit", !!standard.buttons[place]?.pressed);
    sticks.forEach(({ x, y, dot }, index) => {
      dot.setAttribute("cx", x + 6 * standard.axes[2 * index]);
      dot.setAttribute("cy", y + 6 * standard.axes[2 * index + 1]);
    });
    const waits = gamepad.waitsFor(pad);
    if (waits) {
      say(doing, `Let go of sticks and triggers. Nothing moves until each has been at rest (${waits}). STOP is ${STOP_PLACE}.`);
      return;
    }
    const output = driven.scenery.outputs[gamepad.output % driven.scenery.outputs.length];
    say(doing, `${sticksWords(gamepad)}, while a shoulder button is held. STOP is ${STOP_PLACE}.${output ? ` Triggers: ${output.replaceAll("_", " ")}.` : ""}`);
  }
  show(null);
  return { box, show };
}
