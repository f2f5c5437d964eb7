// The bar at the top: the cell, EMULATED or REAL, the robots' phases, the age of the picture, who one is, light or dark.

import { el, part, remember, remembered, say } from "./dom.js";

const SIGNS = { offline: "○", ready: "●", engaged: "▶", braking: "▼", held: "■" };

/** Say which cell it is, and whether its robots are real. */
export function nameCell(scene) {
  say(part("cell"), scene.cell);
  document.title = `deltaq · ${scene.cell}`;
  const reality = part("reality");
  say(reality, scene.emulated ? "EMULATED" : "REAL ROBOTS");
  reality.dataset.real = String(!scene.emulated);
  reality.title = scene.emulated ? "No robot of this cell is real." : "What you do here moves real robots.";
}

/** @param named called with the operator's name when it was entered. */
export function showBar(live, named) {
  let chips = [];
  const age = part("age");
  const name = el("input", { type: "text", maxlength: 32, placeholder: "your name", "aria-label": "Your name", value: remembered("operator", "") });
  const role = el("span");
  part("who").append(name, role);
  name.addEventListener("change", () => named(name.value.trim()));

  /** One a robot, in the order of the status, which is that of the frames too. */
  function build(names) {
    chips = names.map((name) => {
      const sign = el("i", { "aria-hidden": "true" });
      const phase = el("span");
      return { name, sign, phase, chip: el("span", { class: "chip" }, sign, el("b", {}, name), phase) };
    });
    part("chips").replaceChildren(...chips.map(({ chip }) => chip));
  }

  function show() {
    const names = Object.keys(live.status?.robots ?? {});
    if (names.length !== chips.length) build(names);
    chips.forEach(({ chip, sign, phase: words }, index) => {
      const phase = live.isStale(index) ? "offline" : live.frame.robots[index].phase;
      const text = live.frame && live.isStale(index) ? "no data" : phase;
      chip.dataset.phase = phase;
      say(sign, SIGNS[phase]);
      say(words, text);
    });
    const seconds = live.age_s();
    const isStale = live.isStale();
    age.dataset.stale = String(isStale);
    if (!live.connection.isUp) say(age, "no connection");
    else if (!Number.isFinite(seconds)) say(age, "no data");
    else say(age, seconds < 1 ? `data ${Math.max(10, Math.round(seconds * 100) * 10)} ms` : `data ${seconds.toFixed(1)} s`);
    const hello = live.hello;
    name.title = hello ? `Others see you as ${hello.client}.` : "";
    name.disabled = Object.values(live.status?.robots ?? {}).some(({ lease }) => lease.mine); // who has control is told by this name
    name.dataset.asked = String(!!hello?.operator && !remembered("operator", ""));
    say(role, hello && !hello.operator ? "watching only" : "");
  }
  setInterval(show, 200);
  live.addEventListener("status", show);
  live.addEventListener("line", show);
  show();
}

/** The light or the dark look, as the system has it until the button chooses; `follow(enter)` calls enter(isDark) with each. */
export function lightOrDark() {
  const look = part("look");
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  const followers = [];
  function enter(isDark) {
    document.documentElement.dataset.look = isDark ? "dark" : "light";
    say(look, isDark ? "☀" : "☾");
    for (const follower of followers) follower(isDark);
  }
  look.addEventListener("click", () => {
    const isDark = document.documentElement.dataset.look !== "dark";
    remember("dark", isDark);
    enter(isDark);
  });
  system.addEventListener("change", () => remembered("dark", null) ?? enter(system.matches));
  enter(remembered("dark", system.matches));
  return {
    follow(follower) {
      followers.push(follower);
      follower(document.documentElement.dataset.look === "dark");
    },
  };
}

/** Grey out a picture that is old, and say so over it. */
export function coverStale(live) {
  const cover = part("cover");
  const words = el("p");
  cover.append(words);
  setInterval(() => {
    const isStale = live.isStale();
    document.documentElement.dataset.stale = String(isStale);
    if (!isStale) return;
    if (!live.connection.isUp) say(words, "No connection to the console. The picture is old; nothing can be driven from here.");
    else if (!live.frame) say(words, "Waiting for the cell …");
    else say(words, `The newest state of a robot is ${live.age_s().toFixed(1)} s old. The picture is old; nothing can be driven from here.`);
  }, 150);
}
