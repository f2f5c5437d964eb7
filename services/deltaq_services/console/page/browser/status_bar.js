// The bar at the top: the cell, EMULATED or REAL, the robots' phases, the age of the picture, who one is, light or dark.

import { el, part, remember, remembered, say } from "./dom.js";

const SIGNS = { offline: "○", ready: "●", engaged: "▶", braking: "▼", held: "■" };

export function showBar(live, scene, enterRoom) {
  say(part("cell"), scene.cell);
  const reality = part("reality");
  say(reality, scene.emulated ? "EMULATED" : "REAL ROBOTS");
  reality.dataset.real = String(!scene.emulated);
  reality.title = scene.emulated ? "No robot of this cell is real." : "What you do here moves real robots.";

  const chips = scene.robots.map((robot) => {
    const sign = el("i", { "aria-hidden": "true" });
    const phase = el("span");
    const chip = el("span", { class: "chip" }, sign, el("b", {}, robot.name), phase);
    part("chips").append(chip);
    return { chip, sign, phase };
  });
  const age = part("age");
  const who = part("who");

  function show() {
    scene.robots.forEach((robot, index) => {
      const phase = live.isStale(index) ? "offline" : live.frame.robots[index].phase;
      const text = live.frame && live.isStale(index) ? "no data" : phase;
      chips[index].chip.dataset.phase = phase;
      say(chips[index].sign, SIGNS[phase]);
      say(chips[index].phase, text);
    });
    const seconds = live.age_s();
    const isStale = live.isStale();
    age.dataset.stale = String(isStale);
    if (!live.connection.isUp) say(age, "no connection");
    else if (!Number.isFinite(seconds)) say(age, "no data");
    else say(age, seconds < 1 ? `data ${Math.max(10, Math.round(seconds * 100) * 10)} ms` : `data ${seconds.toFixed(1)} s`);
    const hello = live.hello;
    say(who, hello ? (hello.operator ? hello.client : `${hello.client} · looking on`) : "");
  }
  setInterval(show, 200);
  live.addEventListener("status", show);
  live.addEventListener("line", show);
  show();

  const look = part("look");
  const system = window.matchMedia("(prefers-color-scheme: dark)");
  function enter(isDark) {
    document.documentElement.dataset.look = isDark ? "dark" : "light";
    say(look, isDark ? "☀" : "☾");
    enterRoom(isDark);
  }
  look.addEventListener("click", () => {
    const isDark = document.documentElement.dataset.look !== "dark";
    remember("dark", isDark);
    enter(isDark);
  });
  system.addEventListener("change", () => remembered("dark", null) ?? enter(system.matches));
  enter(remembered("dark", system.matches));
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
    if (!live.connection.isUp) say(words, "No connection to the console. What you see is old; nothing can be driven from here.");
    else if (!live.frame) say(words, "Waiting for the cell …");
    else say(words, `No news of a robot for ${live.age_s().toFixed(1)} s. What you see is old; nothing can be driven from here.`);
  }, 150);
}
