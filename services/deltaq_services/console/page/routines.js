// Equipment and what can be done with it: chosen in a list or in the picture, done by a routine that can be paused and given up.

import { THREE } from "./vendor/three.js";
import { el, say } from "./dom.js";
import { holdsFor } from "./hold.js";
import { bodyShell } from "./robots.js";
import { WayPicture } from "./ways.js";

const HOLD_MS = 600;

const ENDS = { done: "done", aborted: "given up", held: "held", failed: "failed", left: "left" };
const words = (name) => name.replaceAll("_", " ");

/** What a routine does now, or how it ended. */
export function progressText({ routine, equipment, step, steps, text, paused, end, why }) {
  const what = [words(routine), equipment].filter(Boolean).join(" ");
  if (end) return `${what}: ${why ? `${ENDS[end] ?? end}. ${why}` : ENDS[end] ?? end}`;
  return `${what}: ${paused ? "paused at " : ""}step ${step + 1} of ${steps}, ${text}`;
}

/** Marks of the items in the picture: the chosen one shines, and a click on one chooses it. */
function itemMarks(stage, structure, items, choose) {
  const paint = new THREE.MeshBasicMaterial({
    color: "#2fa8ff", transparent: true, opacity: 0.45, polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -1,
  });
  const marks = new Map();
  for (const { name, bodies } of items) {
    for (const body of bodies) {
      const mark = bodyShell(structure.bodies.get(body), paint);
      if (!mark) continue;
      mark.visible = false; // raycast even so
      stage.marks.add(mark);
      marks.set(mark, name);
    }
  }
  const { canvas } = stage;
  let down = null;
  canvas.addEventListener("pointerdown", ({ clientX, clientY }) => (down = [clientX, clientY]));
  canvas.addEventListener("click", ({ clientX, clientY }) => {
    if (!down || Math.hypot(clientX - down[0], clientY - down[1]) > 4) return; // the view was turned
    const { left, top, width, height } = canvas.getBoundingClientRect();
    const ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((2 * (clientX - left)) / width - 1, 1 - (2 * (clientY - top)) / height), stage.camera);
    const [hit] = ray.intersectObjects([...marks.keys()], false);
    if (hit) choose(marks.get(hit.object));
  });
  return (name) => {
    for (const [mark, item] of marks) mark.visible = item === name;
    stage.ask();
  };
}

/** @param context {live, scene, driven, stage, structure, views, ways}; ask(type, fields) sends a command for the driven robot. */
export function routinesPanel({ live, scene, driven, stage, structure, views, ways }, ask) {
  let chosen = "";
  let wanted = null; // what is planned, before it may be started
  let refusal = "";
  const picture = new WayPicture(stage, views);
  const list = el("div", { class: "items", role: "radiogroup", "aria-label": "Equipment" });
  for (const { name, kind } of scene.equipment) {
    list.append(el("button", { role: "radio", "data-item": name, title: words(kind), onclick: () => choose(chosen === name ? "" : name) }, words(name)));
  }
  const doable = el("div", { class: "row doable" });
  const doing = el("p", { class: "doing place", role: "status" });
  const progress = el("progress", { max: 1, "aria-label": "Step" });
  const pause = el("button", { onclick: () => ask("routine", { action: live.robot(driven.name)?.routine?.paused ? "go_on" : "pause" }) }, "Pause");
  const abort = el("button", { onclick: () => ask("routine", { action: "abort" }) }, "Give up");
  const resume = el("button", { onclick: resumed }, "Resume");
  const start = el("button", { class: "primary slow" }, "Hold to start");
  const back = el("button", { onclick: () => want(null) }, "Back");
  const outlook = el("p", { class: "forecast", role: "status" });
  const forecast = el("div", {}, el("div", { class: "row" }, start, back), outlook);
  holdsFor(start, HOLD_MS, () => {
    ask("routine", { action: "run", ...wanted });
    want(null);
  });
  const box = el("section", { class: "routines" }, el("h2", {}, "Equipment"), list, doable, forecast, doing, progress, el("div", { class: "row" }, pause, resume, abort));
  const mark = itemMarks(stage, structure, scene.equipment, (name) => choose(name));

  function choose(name) {
    chosen = name;
    mark(name);
    want(null);
  }

  /** Plan a routine and show the whole motion; with null show none. */
  function want(routine) {
    wanted = routine;
    ways.planned = null;
    refusal = "";
    show();
    if (!wanted) return;
    live.send("routine", { robot: driven.name, action: "plan", ...wanted }, ({ outcome, text }) => {
      if (wanted !== routine || ["asked", "done"].includes(outcome)) return;
      refusal = text;
      show();
    });
  }

  function resumed() {
    const { routine, equipment, step } = live.robot(driven.name)?.routine ?? {};
    if (routine) ask("routine", { action: "run", routine, equipment, first: step });
  }

  function show() {
    const robot = live.robot(driven.name);
    const items = scene.equipment.filter((item) => item.robot === driven.name);
    box.hidden = !items.length;
    if (box.hidden || !robot) return;
    for (const button of list.children) {
      button.hidden = !items.some(({ name }) => name === button.dataset.item);
      button.setAttribute("aria-checked", String(button.dataset.item === chosen));
    }
    const item = items.find(({ name }) => name === chosen);
    const names = robot.routines?.[item?.kind ?? ""] ?? [];
    const told = [item?.name ?? "", ...names].join();
    if (doable.dataset.told !== told) {
      doable.dataset.told = told;
      doable.replaceChildren(...names.map((routine) =>
        el("button", { "data-routine": routine, onclick: () => want({ routine, equipment: item?.name ?? "" }) }, words(routine))));
    }
    const { routine } = robot;
    const runs = !!routine && !routine.end;
    const cannot = !!live.cannotDrive(driven.name) || !robot.lease.mine;
    for (const button of doable.children) button.disabled = cannot || runs;
    const planned = ways.planned;
    const isPlanned = !!wanted && planned?.robot === driven.name && planned.routine === wanted.routine && planned.equipment === wanted.equipment;
    forecast.hidden = !wanted || runs;
    picture.show(driven.name, isPlanned && !runs ? planned.ways[0] : null);
    say(outlook, refusal || (isPlanned ? `Forecast: ${planned.ways[0].text}.` : "Planning …"));
    start.disabled = cannot || !isPlanned;
    say(doing, routine ? progressText(routine) : robot.lease.mine ? "" : "Take the robot, and it can work on the equipment.");
    progress.style.visibility = runs ? "" : "hidden";
    progress.value = routine?.done ?? 0;
    pause.hidden = abort.hidden = !runs;
    resume.hidden = !routine || runs || routine.step >= routine.steps || routine.end === "done";
    pause.disabled = abort.disabled = resume.disabled = cannot;
    say(pause, routine?.paused ? "Go on" : "Pause");
  }
  ways.addEventListener("change", show);
  return { box, show };
}
