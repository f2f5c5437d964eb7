// Which robot's hand a camera looks at, and which while that one is hidden. Of two robots there is no choice.

import { el, say } from "./dom.js";

/** The targets of a `look_at`: the names that were chosen, each once. */
export function targetsOf(chosen) {
  return [...new Set(chosen.filter(Boolean))];
}

/** @param context {live, scene, driven}; ask(type, fields) sends a command for the driven robot. */
export function lookAtPanel({ live, scene, driven }, ask) {
  const first = el("select", { "aria-label": "Looks at" });
  const second = el("select", { "aria-label": "And if that is hidden, at" });
  const told = el("output");
  const box = el("div", { class: "field" }, el("label", {}, "Looks at"), told, el("div", { class: "row" }, first, el("span", {}, "else"), second));
  for (const select of [first, second]) {
    select.addEventListener("change", () => {
      const targets = targetsOf([first.value, second.value]);
      if (targets.length) ask("look_at", { targets });
    });
  }
  let filledFor = null;

  /** Options for the robot that is driven. */
  function fill() {
    if (filledFor === driven.name) return;
    filledFor = driven.name;
    const others = scene.robots.map(({ name }) => name).filter((name) => name !== driven.name);
    const options = () => others.map((name) => el("option", { value: name }, name));
    first.replaceChildren(el("option", { value: "", hidden: true }, "–"), ...options());
    second.replaceChildren(el("option", { value: "" }, "–"), ...options());
  }

  function show() {
    box.hidden = !driven.scenery.camera || scene.robots.length < 3;
    const robot = live.robot(driven.name);
    if (box.hidden || !robot) return;
    fill();
    const off = { view_hidden: ", hidden", view_out_of_reach: ", out of reach" }[robot.sight] ?? "";
    say(told, robot.looks_at ? `now ${robot.looks_at}${off}` : "");
    [first, second].forEach((select, place) => {
      select.disabled = !!live.locked(driven.name);
      if (document.activeElement !== select) select.value = robot.targets[place] ?? "";
    });
  }

  return { box, show };
}
