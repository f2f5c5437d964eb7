// The panel on the left: which robot, who has it, how it is driven, and its digital signals.

import { advisorCards } from "./advisor_cards.js";
import { el, part, say } from "./dom.js";
import { ALL, handsPanel, OBJECT } from "./hands.js";
import { holdsFor } from "./hold.js";
import { jogPad } from "./jog.js";
import { lookAtPanel } from "./look_at.js";
import { masterPanel } from "./master.js";
import { MODES, modesOf } from "./modes.js";
import { posePanel } from "./pose_panel.js";
import { routinesPanel } from "./routines.js";

const TAKE_OVER_MS = 1000;
const [LATE_MS, STARTS_MS, TOLD_MS] = [5000, 60000, 4000]; // before a robot is taken its driver may have to start
const TITLES = {
  take: "Take control", take_over: "Take over", release: "Release", grant: "Hand over", refuse: "Keep it",
  lease: "Ask for it", reset: "Reset", mode: "Mode", output: "Output", view_distance: "View distance", look_at: "Looks at", choose_master: "Master", advise: "Options", routine: "Routine",
};
const ANSWERS = {
  done: () => "done", asked: () => "asked", refused: (text) => `refused, ${text}`, expired: (text) => `not done, ${text}`,
  lost: (text) => `not confirmed, ${text}; press again`, not_sent: (text) => `not sent, ${text}`,
};
const SEEN_MS = 700; // a banner that has just come cannot be answered yet: a press was meant for what it covers
const FOLLOW_MS = 800; // a robot that follows moves by itself: held, so that it is meant

/** What is driven now; the rest of the page reads it. */
export class Driven extends EventTarget {
  constructor(live, scene) {
    super();
    Object.assign(this, { live, scene, name: scene.robots.at(-1).name, share: 0.3, bySteps: false, _joint: 0, _hands: new Map() });
  }

  get scenery() {
    return this.scene.robots.find((robot) => robot.name === this.name);
  }

  get mode() {
    return this.live.robot(this.name)?.mode ?? null;
  }

  get frame() {
    return this.live.robot(this.name)?.frame ?? "world";
  }

  get grip() {
    return this.live.robot(this.name)?.grip ?? "free";
  }

  /** Names of the robot's hands. */
  get hands() {
    return this.scenery.tools.map(({ name }) => name);
  }

  /** What is moved: one hand, all of them, or the object between them. */
  get moved() {
    return this.grip === OBJECT ? OBJECT : (this._hands.get(this.name) ?? ALL);
  }

  chooseHand(hand) {
    this._hands.set(this.name, hand);
  }

  /** Whether wishes are speeds of joints in this mode; else they are twists of the hand. */
  get isByJoints() {
    return ["joint", "self-motion", null].includes(this.mode);
  }

  /** Whether it goes along ways that are shown first, while something is held. */
  get goesAlongWays() {
    return ["advisor", "pose"].includes(this.mode);
  }

  /** Share of full speed, 0.05 to 1, changed by so much. */
  changeShare(change) {
    this.share = Math.min(1, Math.max(0.05, Math.round(20 * (this.share + change)) / 20));
    this._tell();
  }

  /** Whether the robot is moved by hand in this mode, by buttons, keys and sticks. */
  get isJogged() {
    return !this.goesAlongWays && this.mode !== "follow";
  }

  /** Whether each press of a button moves by one step, in place of for as long as it is held. */
  chooseSteps(bySteps) {
    this.bySteps = bySteps;
    this._tell();
  }

  choose(name) {
    this.name = name;
    this._tell();
  }

  /** The joint that keys and sticks move, in modes of joints. */
  get joint() {
    return Math.min(this._joint, this.scenery.joints.length - 1);
  }

  chooseJoint(index) {
    this._joint = index;
    this._tell();
  }

  _tell() {
    this.dispatchEvent(new Event("change"));
  }

  // what wish.js asks
  jogs = () => this.isJogged;
  robot = () => this.name;
  length = () => (this.isByJoints ? this.scenery.joints.length : 6);
  hand() {
    if (this.isByJoints) return "";
    if (this.hands.length < 2) return this.hands[0];
    return this.moved === OBJECT ? ALL : this.moved;
  }
}

/** Who asks for a robot that this page has control of: over the cell, until it is answered. */
function requests(live, ask) {
  const box = part("asks");
  function show() {
    const robots = Object.entries(live.status?.robots ?? {}).filter(([, { lease }]) => lease.mine && lease.wanted_by);
    const told = JSON.stringify(robots.map(([name, { lease }]) => [name, lease.wanted_by]));
    if (box.dataset.told === told) return; // a button that is pressed stays
    box.dataset.told = told;
    const answer = (robot, action, text, look) => {
      const button = el("button", { class: look, disabled: true, onclick: () => ask("lease", { robot, action }) }, text);
      setTimeout(() => (button.disabled = false), SEEN_MS);
      return button;
    };
    box.replaceChildren(...robots.map(([name, { lease }]) =>
      el("p", {}, el("span", {}, `${lease.wanted_by} asks for ${name}.`), answer(name, "grant", "Hand over", "primary"), answer(name, "refuse", "Keep it", ""))));
  }
  live.addEventListener("status", show);
}

/** @param context {live, scene, driven, wish, stage, views, ways, picture, thumbnails, follower}. */
export function drivingPanel(context) {
  const { live, scene, driven, wish, follower } = context;
  const panel = part("driving");
  const tabs = el("div", { class: "tabs", role: "tablist" });
  const body = el("div", { class: "driving" });
  panel.append(tabs, body);
  for (const robot of scene.robots) {
    tabs.append(
      el("button", { role: "tab", "data-robot": robot.name, onclick: () => driven.choose(robot.name) },
        el("b", {}, robot.name),
        el("small", {}, robot.camera ? "camera" : robot.outputs?.length ? "gripper" : ""),
      ),
    );
  }

  const answer = el("p", { class: "answer", role: "status" });
  let late = null;
  /** Send a command; what became of it is always told. */
  async function ask(type, fields) {
    const what = TITLES[fields?.action] ?? TITLES[type];
    const isTaken = ["take", "take_over"].includes(fields?.action);
    const tell = (outcome, words) => {
      clearTimeout(late);
      answer.dataset.outcome = outcome;
      say(answer, `${what}: ${words}.`);
      answer.parentElement.scrollTop = 0;
    };
    const id = (ask.count = (ask.count ?? 0) + 1);
    const heard = ({ outcome, text }) => {
      if (id !== ask.count) return; // another was asked since
      tell(outcome, isTaken && outcome === "asked" ? "asked, the robot's driver gets ready" : ANSWERS[outcome](text.replace(/^[a-z_]+: /, "").replace(/\.$/, "")));
      if (outcome === "asked") late = setTimeout(() => tell("lost", ANSWERS.lost("no answer yet")), isTaken ? STARTS_MS : LATE_MS);
      if (outcome === "done") late = setTimeout(() => say(answer, ""), TOLD_MS);
    };
    const ack = await live.send(type, { robot: driven.name, ...fields }, heard);
    if (ack.outcome === "not_sent") heard(ack);
  }

  const phase = el("p", { class: "phase" });
  const remedy = el("p", { class: "remedy" });
  const reset = el("button", { class: "primary", onclick: () => ask("reset") }, "Reset");
  const resetAll = el("button", { onclick: () => held().forEach((robot) => ask("reset", { robot })) }, "Reset all");
  const held = () => Object.keys(live.status?.robots ?? {}).filter((name) => live.status.robots[name].phase === "held");
  const lease = el("p", { class: "lease" });
  const buttons = {
    take: ["Take control", "primary"], ask: ["Ask for it", "primary"], release: ["Release", ""],
  };
  // against the will of a holder who cannot be asked from here: held, so that it is meant
  const takeOver = el("button", { class: "slow" }, "Hold to take over");
  holdsFor(takeOver, TAKE_OVER_MS, () => ask("lease", { action: "take_over" }));
  const verbs = Object.fromEntries(
    Object.entries(buttons).map(([verb, [text, look]]) => [
      verb, el("button", { class: look, onclick: () => ask("lease", { action: verb }) }, text),
    ]),
  );
  const modes = el("div", { class: "modes", role: "radiogroup", "aria-label": "Mode" });
  for (const [mode, title, what] of MODES) {
    const button = el("button", { role: "radio", "data-mode": mode, title: what }, title);
    const begin = () => ask("mode", { mode, frame: driven.frame });
    if (mode === "follow") {
      button.classList.add("slow");
      holdsFor(button, FOLLOW_MS, begin);
    } else button.addEventListener("click", begin);
    modes.append(button);
  }
  const frames = el("div", { class: "frames", role: "radiogroup", "aria-label": "Axes of the hand" },
    ...["world", "tool"].map((frame) =>
      el("button", { role: "radio", "data-frame": frame, onclick: () => ask("mode", { mode: driven.mode ?? "coupled", frame }) }, frame)),
  );
  const doing = el("p", { class: "doing place" });
  const share = el("input", { type: "range", min: 5, max: 100, step: 5, value: 30, "aria-label": "Speed" });
  const shareText = el("output", {}, "30 %");
  share.addEventListener("input", () => driven.changeShare(share.value / 100 - driven.share));
  const distance = el("input", { type: "range", min: 0.4, max: 2.5, step: 0.05, value: 1, "aria-label": "View distance" });
  const distanceText = el("output", {}, "");
  distance.addEventListener("input", () => say(distanceText, `${Number(distance.value).toFixed(2)} m`));
  distance.addEventListener("change", () => ask("view_distance", { value_m: Number(distance.value) }));
  const pad = jogPad(live, driven, wish);
  const zoom = el("div", { class: "field" }, el("label", {}, "View distance"), distanceText, distance);
  const speed = el("div", { class: "field" }, el("label", {}, "Speed"), shareText, share);
  const modeBox = el("section", {}, el("h2", {}, "Mode"), modes, frames, doing);
  const through = el("progress", { max: 1, value: 1, "aria-label": "Goes through" });
  const throughText = el("output", {}, "all");
  const throughBox = el("div", { class: "field through" }, el("label", {}, "Goes through"), throughText, through);
  const moveBox = el("section", {}, el("h2", {}, "Move"), speed, throughBox, pad);
  const signals = el("section", { class: "signals" });
  const advisor = advisorCards(context, ask);
  const pose = posePanel(context, ask);
  const hands = handsPanel(context, ask);
  const master = masterPanel(context, ask);
  const lookAt = lookAtPanel(context, ask);
  const routines = routinesPanel(context, ask);
  body.append(
    el("section", { class: "card" }, el("div", { class: "place" }, answer, phase, remedy, lease), el("div", { class: "row" }, ...Object.values(verbs), takeOver, reset, resetAll)),
    modeBox, hands.box, moveBox, advisor.box, pose.box, zoom, lookAt.box, master.box, routines.box, signals,
  );

  function show() {
    const robot = live.robot(driven.name);
    for (const tab of tabs.children) tab.setAttribute("aria-selected", String(tab.dataset.robot === driven.name));
    if (!robot) return;
    const { holder, outside, mine, wanted_by: wantedBy, text } = robot.lease;
    const locked = live.locked(driven.name);
    body.dataset.mine = String(mine);
    phase.dataset.phase = robot.phase;
    const { hli, text: why, remedy: starts } = live.status;
    say(phase, hli ? robot.text : "the HLI is silent");
    say(remedy, hli ? robot.remedy : `${starts}. (${why.replace(/\.$/, "")}.)`);
    reset.hidden = robot.phase !== "held";
    resetAll.hidden = reset.hidden || held().length < 2;
    reset.disabled = resetAll.disabled = !!locked;
    const elsewhere = outside ? " It is not a browser at this console. Wait until it releases the robot, or take the robot over: it comes to rest first." : "";
    const whose = mine ? "You have control." : holder ? `${holder} has control.${elsewhere}` : "Nobody has control.";
    const me = live.hello?.client;
    say(lease, wantedBy && !mine ? `${whose} ${wantedBy === me ? "You have asked for it." : `${wantedBy} asks for it.`}` : text ? `${whose} ${text}` : whose);
    verbs.take.hidden = mine || !!holder;
    verbs.ask.hidden = mine || !holder || outside || wantedBy === me;
    takeOver.hidden = mine || !outside;
    takeOver.disabled = !!locked;
    verbs.release.hidden = !mine;
    for (const button of Object.values(verbs)) button.disabled = !!locked;

    const offered = modesOf(driven.scenery);
    for (const button of modes.children) {
      const { mode } = button.dataset;
      button.hidden = !offered.includes(mode);
      button.setAttribute("aria-checked", String(robot.mode === mode));
      button.disabled = !!locked || !mine;
    }
    frames.style.visibility = driven.isByJoints || !(driven.isJogged || robot.mode === "pose") ? "hidden" : ""; // its place stays
    for (const button of frames.children) {
      button.setAttribute("aria-checked", String(robot.frame === button.dataset.frame));
      button.disabled = !!locked || !mine;
    }
    say(doing, robot.mode === "advisor" ? "" : robot.driving);
    advisor.show();
    pose.show();
    hands.show();
    master.show();
    lookAt.show();
    routines.show();
    zoom.hidden = robot.mode !== "follow" && !(outside && driven.scenery.camera);
    distance.disabled = !!locked; // whoever follows with the robot takes it, here or elsewhere
    // a follower elsewhere that nobody told another distance does not say which it keeps: then the one that is seen
    const own = follower?.followers.find(({ name }) => name === driven.name);
    const seen_m = own ? follower.error(own)?.distance : null;
    const shown_m = robot.view_distance_m ?? seen_m;
    if (shown_m && document.activeElement !== distance) {
      distance.value = shown_m;
      say(distanceText, robot.view_distance_m ? `${shown_m.toFixed(2)} m` : `${shown_m.toFixed(2)} m now`);
    }
    share.value = Math.round(100 * driven.share);
    say(shareText, `${share.value} %`);
    moveBox.hidden = !mine || !driven.isJogged;
    through.value = robot.goes_through;
    say(throughText, robot.goes_through === 1 ? "all" : `${Math.round(100 * robot.goes_through)} %`);
    showSignals(robot, locked || !mine);
  }

  function showSignals(robot, locked) {
    const told = JSON.stringify([robot.outputs, robot.inputs, locked]);
    if (signals.dataset.told === told) return;
    signals.dataset.told = told;
    const names = Object.keys(robot.outputs);
    signals.hidden = !names.length && !Object.keys(robot.inputs).length;
    signals.replaceChildren(
      el("h2", {}, "Signals"),
      ...names.map((name, index) =>
        el("button", {
          class: "signal", role: "switch", "aria-checked": String(robot.outputs[name]), disabled: !!locked,
          onclick: () => ask("output", { index, value: !robot.outputs[name] }),
        }, el("i"), name.replaceAll("_", " "))),
      ...Object.entries(robot.inputs).map(([name, isOn]) =>
        el("span", { class: "signal input", "data-on": String(isOn) }, el("i"), name.replaceAll("_", " "), el("small", {}, isOn ? "on" : "off"))),
    );
  }
  for (const kind of ["status", "line"]) live.addEventListener(kind, show);
  driven.addEventListener("change", show);
  setInterval(show, 500);
  show();
  requests(live, ask);
  return { ask, pose, hands };
}
