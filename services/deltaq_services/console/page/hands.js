// Which hand of several is moved, and whether all of them hold one object.

import { degrees, el, say } from "./dom.js";

export const ALL = "*"; // all hands, as a jog has it
export const OBJECT = "object"; // all hands, with an object between them
const PARTS_HANDS = ["joint", "pose", "follow"]; // modes that are refused while they hold one

/** What can be moved of a robot with several hands, in the order of the key; of one hand nothing is chosen. */
export function handChoices(names) {
  return names.length > 1 ? [ALL, ...names, OBJECT] : [];
}

/** What the key chooses after `now`; an object only where the mode lets the hands hold one. */
export function nextChoice(names, now, mode) {
  const choices = handChoices(names).filter((choice) => choice !== OBJECT || !PARTS_HANDS.includes(mode));
  return choices[(choices.indexOf(now) + 1) % choices.length];
}

/** Whether a mode can be chosen while the hands hold what they do. */
export function keepsGrip(mode, grip) {
  return grip !== OBJECT || !PARTS_HANDS.includes(mode);
}

/** How hands hold, in words. */
export function gripWords(grip, off, choice) {
  if (grip !== OBJECT) return choice === ALL ? "Both get the same command; each turns about its own point." : "";
  if (!off) return "The hands take the object once they are at rest.";
  return `Object held. The hands have slipped by ${(1000 * off.distance_m).toFixed(1)} mm, ${degrees(off.angle_rad).toFixed(2)}°.`;
}

/** @param ask(type, fields) sends a command. */
export function handsPanel({ live, driven, wish }, ask) {
  const words = el("p", { class: "doing grip place", role: "status" });
  const choices = el("div", { class: "frames", role: "radiogroup", "aria-label": "What to move" });
  const box = el("section", { class: "hands" }, el("h2", {}, "Hands"), choices, words);
  let shown = "";

  function choose(choice) {
    const { mode, frame, grip } = driven;
    wish.releaseAll(); // what is held was meant for another hand
    if (choice !== OBJECT) driven.chooseHand(choice);
    const wanted = choice === OBJECT ? OBJECT : "free";
    if (grip !== wanted) ask("mode", { mode, frame, grip: wanted });
    show();
  }

  function build() {
    if (shown === driven.name) return;
    shown = driven.name;
    const titles = { [ALL]: "both", [OBJECT]: "object" };
    const told = { [ALL]: "the same command for each hand, which turns about its own point", [OBJECT]: "both hands hold one object and move together" };
    choices.replaceChildren(...handChoices(driven.hands).map((choice) =>
      el("button", { role: "radio", "data-hand": choice, title: told[choice] ?? `the ${choice} hand alone`, onclick: () => choose(choice) }, titles[choice] ?? choice)));
  }

  function show() {
    build();
    const robot = live.robot(driven.name);
    box.hidden = driven.hands.length < 2 || !robot?.lease.mine || driven.mode === "follow";
    for (const button of choices.children) {
      button.setAttribute("aria-checked", String(button.dataset.hand === driven.moved));
      button.disabled = !!live.locked(driven.name);
    }
    say(words, driven.isByJoints && driven.grip !== OBJECT ? "" : gripWords(driven.grip, robot?.hands_off, driven.moved));
  }

  /** What the key does. */
  function next() {
    if (driven.hands.length > 1 && live.robot(driven.name)?.lease.mine) choose(nextChoice(driven.hands, driven.moved, driven.mode));
  }
  return { box, show, next };
}
