// Configurations to go to: home, those that the operator saved in this browser, and joints that are typed.

import { el, jointText, remember, remembered, say } from "./dom.js";

/** @param want(q) asks for the way to a configuration, (n,) [rad or m]. */
export function jointTargets({ live, scene, driven }, want) {
  const places = el("select", { "aria-label": "Go to a saved position" });
  const name = el("input", { type: "text", maxlength: 24, placeholder: "name of this position", "aria-label": "Name of this position" });
  const save = el("button", { onclick: () => name.value.trim() && keep({ ...saved(), [name.value.trim()]: now() }) }, "Save");
  const forget = el("button", { onclick: () => keep(Object.fromEntries(Object.entries(saved()).filter(([place]) => place !== places.value))) }, "Forget");
  const rows = el("div", { class: "coordinates" });
  const box = el("details", { class: "targets" }, el("summary", {}, "Home, saved positions, joints"),
    el("div", { class: "row" }, places, forget), el("div", { class: "row" }, name, save), rows);
  let fields = [];

  const key = () => `positions.${scene.cell}.${driven.name}`;
  const saved = () => remembered(key(), {});
  const within = (q) => q.map((value, k) => Math.min(driven.scenery.joints[k].upper, Math.max(driven.scenery.joints[k].lower, value)));
  const now = () => within(Array.from(live.frame.robots[live.indexOf(driven.name)].q));

  function keep(positions) {
    remember(key(), positions);
    name.value = "";
    list();
  }

  function list() {
    places.replaceChildren(...["Go to …", "home", ...Object.keys(saved())].map((place, k) => el("option", { value: k ? place : "" }, place)));
  }

  places.addEventListener("change", () => {
    const q = places.value === "home" ? driven.scenery.home : saved()[places.value];
    if (q) want(q);
  });

  /** Of the robot that is driven now. */
  function build() {
    list();
    fields = driven.scenery.joints.map((joint, k) => {
      const [unit, scale] = joint.unit === "rad" ? ["°", 180 / Math.PI] : ["mm", 1000];
      const field = el("input", { type: "number", step: 1, title: `${jointText(joint.lower, joint.unit)} to ${jointText(joint.upper, joint.unit)}`, "aria-label": `${joint.name.toUpperCase()} in ${unit}` });
      field.addEventListener("change", () => {
        if (field.value !== "") want((box.target ?? now()).map((value, index) => (index === k ? Number(field.value) / scale : value)));
      });
      return { field, scale };
    });
    rows.replaceChildren(...driven.scenery.joints.flatMap(({ name: joint }, k) => [el("label", {}, joint.toUpperCase()), fields[k].field]));
  }

  /** Write into the fields where the robot is to go, or where it is. */
  function show(target) {
    if (!live.frame) return;
    box.target = target;
    if (!target && document.activeElement !== places) places.value = "";
    const q = target ?? now();
    fields.forEach(({ field, scale }, k) => document.activeElement === field || (field.value = (scale * q[k]).toFixed(scale === 1000 ? 0 : 1)));
    forget.disabled = !(places.value in saved());
    say(save, name.value.trim() in saved() ? "Replace" : "Save");
  }
  return { box, build, show };
}
