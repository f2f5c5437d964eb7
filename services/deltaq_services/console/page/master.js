// Another robot of the cell as the master: its tool leads the hand while a button is held.

import { el } from "./dom.js";
import { holds } from "./hold.js";

const SCALE = { min: 0.01, max: 5, step: 0.01, value: 0.5 };

/** @param ask(type, fields) sends a command. */
export function masterPanel({ live, scene, driven, wish }, ask) {
  const select = el("select", { "aria-label": "Master" });
  const scale = el("input", { type: "number", ...SCALE, "aria-label": "Motion of the hand for each metre of the master's motion" });
  const couple = el("button", { class: "primary hold-to-go" }, "Hold to be led");
  const box = el("section", { class: "master" },
    el("h2", {}, "Master"),
    el("div", { class: "led" }, el("label", {}, "led by"), select, el("label", {}, "times"), scale),
    couple,
  );
  let shown = "";

  const choose = () => scale.reportValidity() && ask("choose_master", { master: select.value, scale: Number(scale.value) });
  select.addEventListener("change", choose);
  scale.addEventListener("change", () => select.value && choose());
  holds(couple, () => wish.hold("master", { led: true }), () => wish.release("master"));

  function show() {
    const robot = live.robot(driven.name);
    const others = scene.robots.filter(({ name }) => name !== driven.name).map(({ name }) => name);
    box.hidden = !others.length || !robot?.lease.mine || !driven.isJogged || driven.isByJoints;
    if (shown !== driven.name) {
      shown = driven.name;
      select.replaceChildren(el("option", { value: "" }, "nobody"), ...others.map((name) => el("option", { value: name }, name)));
    }
    if (document.activeElement !== select) select.value = robot?.master ?? "";
    if (robot?.master && document.activeElement !== scale) scale.value = robot.master_scale;
    select.disabled = scale.disabled = !!live.locked(driven.name);
    couple.disabled = !!live.cannotDrive(driven.name) || !robot?.master;
    if (!wish.isActive) delete couple.dataset.held;
  }
  return { box, show };
}
