// A pose of the hand that is dragged in the picture: what would be admitted is shown first, and the robot goes only
// while a button is held.

import { anglesOf, el, jointText, remember, remembered, say } from "./dom.js";
import { quaternionOf, withAngles } from "./drag_math.js";
import { Gizmo } from "./gizmo.js";
import { holds } from "./hold.js";

const ASK_AGAIN_MS = 200; // while it is dragged
const AXES = ["x", "y", "z", "A", "B", "C"]; // A B C turn about z, y, x

/** @param context {live, driven, wish, stage, views, ways, picture}; ask(type, fields) sends a command. */
export function posePanel(context, ask) {
  const { live, driven, wish, stage, views, ways, picture } = context;
  const gizmo = new Gizmo(stage);
  const words = el("p", { class: "forecast", role: "status" });
  const gate = el("p", { class: "doing" });
  const share = el("progress", { max: 1, value: 0, "aria-label": "Clear part of the path" });
  const go = el("button", { class: "primary hold-to-go" }, "Hold to go");
  const back = el("button", {}, "Back");
  const tools = el("select", { "aria-label": "Hand" });
  const fields = AXES.map((axis, k) => {
    const field = el("input", { type: "number", step: k < 3 ? 10 : 5, "aria-label": `${axis} of the hand in ${k < 3 ? "mm" : "°"}` });
    field.addEventListener("change", () => {
      if (!gizmo.T || field.value === "") return;
      const angles = anglesOf(gizmo.T);
      if (k >= 3) angles[k - 3] = Number(field.value);
      const T = k < 3 ? Float64Array.from(gizmo.T) : withAngles(gizmo.T, angles);
      if (k < 3) T[12 + k] = Number(field.value) / 1000;
      gizmo.place(T, driven.frame === "tool");
      want();
    });
    return field;
  });
  const targets = jointTargets(context, want);
  const box = el("section", { class: "pose" },
    el("h2", {}, "Pose"),
    el("p", { class: "doing" }, "Drag the arrows and rings at the hand, or enter a pose [mm, °]. The robot does not move yet."),
    tools,
    el("div", { class: "coordinates" }, ...AXES.flatMap((axis, k) => [el("label", {}, axis), fields[k]])),
    el("div", { class: "row" }, go, back), words, share, gate, targets.box,
  );
  let robot = "";
  let asked = { isBusy: false, isWanted: false, since: 0 };
  let dryRunOf = null;
  let refusal = "";

  holds(go, () => wish.hold("pose", { option: 1 }), () => wish.release("pose"));
  back.addEventListener("click", reset);
  tools.addEventListener("change", reset);

  const viewOf = () => views.find(({ name }) => name === driven.name);

  /** The gizmo at the hand, and no way. */
  function reset() {
    const index = Math.max(0, tools.selectedIndex);
    gizmo.place(viewOf().toolPose(index), driven.frame === "tool");
    picture.show(driven.name, null);
    refusal = "";
    asked.isDragged = false;
    asked.joints = null;
    write();
  }

  function write() {
    const values = [12, 13, 14].map((k) => Math.round(1000 * gizmo.T[k])).concat(anglesOf(gizmo.T).map((angle) => angle.toFixed(1)));
    fields.forEach((field, k) => document.activeElement === field || (field.value = values[k]));
  }

  /** Ask for the way to where the gizmo is, or to joints; of what was asked meanwhile only the newest counts. */
  async function want(joints = null) {
    asked.isDragged = true;
    asked.joints = joints;
    write();
    if (asked.isBusy) {
      asked.isWanted = true;
      return;
    }
    asked.isBusy = true;
    asked.isWanted = false;
    const T = gizmo.T;
    const position_m = [T[12], T[13], T[14]];
    const heard = (ack) => {
      if (ack.outcome === "asked") return;
      if (ack.outcome === "expired") asked.isWanted = true; // the pose is wanted still, and nothing moves by it
      refusal = ack.outcome === "done" ? "" : ack.text;
      setTimeout(() => {
        asked.isBusy = false;
        if (asked.isWanted) want(asked.joints);
        show();
      }, gizmo.isHeld ? ASK_AGAIN_MS : 0);
    };
    if (joints) live.send("reach_joints", { robot: driven.name, q: joints }, heard);
    else live.send("reach", { robot: driven.name, hand: tools.value, position_m, quaternion_wxyz: quaternionOf(T) }, heard);
  }
  for (const kind of ["drag", "dragend"]) gizmo.addEventListener(kind, () => want());

  /** What the gate itself says of the first step, asked once for each way. */
  function dryRun(way) {
    if (dryRunOf === way || !way.first.length || gizmo.isHeld) return;
    dryRunOf = way;
    say(gate, "");
    live.send("dry_run", { robot: driven.name, dq: way.first }, (ack) => {
      if (dryRunOf !== way || ack.outcome === "asked") return;
      say(gate, ack.verdict ? `Dry run of the first step: ${ack.verdict}${ack.text ? `, ${ack.text}` : ""}.` : ack.text);
    });
  }

  function show() {
    const told = live.robot(driven.name);
    const isOn = told?.mode === "pose" && told.lease.mine && !live.replay;
    box.hidden = told?.mode !== "pose";
    if (!isOn) {
      gizmo.hide();
      robot = "";
      return;
    }
    if (robot !== driven.name) {
      robot = driven.name;
      tools.replaceChildren(...driven.scenery.tools.map(({ name }) => el("option", {}, name)));
      tools.hidden = driven.scenery.tools.length < 2;
      dryRunOf = null;
      targets.build();
      reset();
    }
    targets.show(asked.joints);
    if (gizmo.byHand !== (driven.frame === "tool") && !gizmo.isHeld) gizmo.place(gizmo.T, driven.frame === "tool");
    const [way] = asked.isDragged ? ways.of(driven.name, "pose") : [];
    const { search } = told;
    const cannot = live.cannotDrive(driven.name);
    const isThere = !!search?.arrived;
    if (isThere && !refusal && !wish.isActive && asked.isDragged && !asked.isBusy && !gizmo.isHeld) reset();
    picture.show(driven.name, refusal || !asked.isDragged ? null : (way ?? null), false);
    say(words, refusal || (way ? `Forecast: ${way.text}.` : asked.isDragged ? "Planning a path …" : ""));
    words.dataset.clear = String(!refusal && (way?.clear ?? 1) === 1);
    share.hidden = !way || !!refusal;
    share.value = way?.clear ?? 0;
    if (!wish.isActive) delete go.dataset.held;
    go.disabled = !!cannot || !way || !!refusal;
    say(go, search?.driven > 0 && !isThere ? `Hold to continue, ${Math.round(100 * search.driven)} % done` : "Hold to go");
    if (way && !refusal) dryRun(way);
    else say(gate, "");
  }
  ways.addEventListener("change", show);
  return { box, show, gizmo };
}

// Configurations to go to: home, those that the operator saved in this browser, and joints that are typed.

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
