// The recording in the scene: framed and named as such, with its timeline below and its verdicts beside it.

import { dateText, el, part, say } from "./dom.js";
import { Player, Replay, SPEEDS } from "./replay.js";

const DRAW_MS = 40;
const LISTED = 400;

const clock = (time_s) => `${Math.floor(time_s / 60)}:${(time_s % 60).toFixed(2).padStart(5, "0")}`;

/** Returns {open(document), close(), replay, player}. */
export function replayBar(live, scene) {
  const box = part("replay");
  const title = el("b");
  const notes = el("small");
  const play = el("button", { class: "primary", onclick: () => toggle() }, "Play");
  const slide = el("input", { type: "range", min: 0, step: 0.01, value: 0, "aria-label": "Time of the recording" });
  const time = el("output");
  const speed = el("select", { "aria-label": "Speed of the recording" }, ...SPEEDS.map((one) => el("option", { value: one, selected: one === 1 }, `${one}×`)));
  const next = el("button", { onclick: () => step() }, "Next refusal");
  const close = el("button", { onclick: () => shut() }, "Back to the live cell");
  const banner = el("header", { role: "status" }, el("strong", {}, "RECORDING"), title, el("span", {}, "not the live cell; nothing can be driven"), notes, close);
  box.append(banner, el("div", { class: "transport" }, play, time, slide, speed, next));
  const list = el("ol", { class: "verdicts" });
  const none = el("p", { class: "doing" }, "Every increment was admitted as requested.");
  const side = el("section", { class: "replay-side", hidden: true }, el("h2", {}, "Verdicts other than admitted"), none, list);
  part("figures").prepend(side);

  const open = { replay: null, player: null };
  let timer = null;
  const now_s = () => performance.now() / 1000;

  function begin(document_) {
    const replay = new Replay(document_, scene);
    Object.assign(open, { replay, player: new Player(replay.length_s) });
    open.player.speed = Number(speed.value);
    slide.max = replay.length_s;
    say(title, replay.name);
    const began = replay.begin_s ? dateText(replay.begin_s) : "in virtual time";
    say(notes, [began, ...replay.notices].join(" · "));
    list.replaceChildren(...replay.verdicts.slice(0, LISTED).map((line) =>
      el("li", {}, el("button", { "data-outcome": line.outcome, onclick: () => seek(line.time_s) },
        el("time", {}, clock(line.time_s)), el("b", {}, `${line.robot} ${line.outcome}`),
        el("span", {}, line.count > 1 ? `${line.text}, ${line.count} times` : line.text)))));
    none.hidden = replay.verdicts.length > 0;
    box.hidden = side.hidden = false;
    document.documentElement.dataset.replay = "true";
    live.showReplay(replay);
    clearInterval(timer);
    timer = setInterval(draw, DRAW_MS);
    draw();
  }

  function shut() {
    clearInterval(timer);
    Object.assign(open, { replay: null, player: null });
    box.hidden = side.hidden = true;
    delete document.documentElement.dataset.replay;
    live.showReplay(null);
  }

  function draw() {
    const { replay, player } = open;
    const at = player.advance(now_s());
    live.show(replay.frame(at));
    if (document.activeElement !== slide || player.isPlaying) slide.value = at;
    say(time, `${clock(at)} / ${clock(replay.length_s)}`);
    say(play, player.isPlaying ? "Pause" : "Play");
    next.disabled = replay.nextRefusal() === null;
    const current = new Set(replay.current());
    [...list.children].forEach((line, place) => line.toggleAttribute("data-now", current.has(place)));
  }

  function toggle() {
    open.player.toggle(now_s());
    draw();
  }

  function seek(time_s) {
    open.player.seek(time_s);
    draw();
    list.querySelector("[data-now]")?.scrollIntoView({ block: "nearest" });
  }

  function step() {
    const at = open.replay.nextRefusal();
    if (at === null) return;
    open.player.isPlaying = false;
    seek(at);
  }

  slide.addEventListener("input", () => seek(Number(slide.value)));
  speed.addEventListener("change", () => open.player && (open.player.speed = Number(speed.value)));
  return Object.assign(open, { open: begin, close: shut });
}
