// The list of recordings: record the cell, and open what was recorded.

import { dateText, el, part, say } from "./dom.js";

const size = (bytes) => (bytes < 1e6 ? `${Math.max(1, Math.round(bytes / 1e3))} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

/** @param open called with a recording's document. */
export function recordings(live, scene, open) {
  const button = part("recordings");
  const box = part("library");
  const answer = el("p", { class: "answer", role: "status" });
  const state = el("p", { class: "doing" });
  const record = el("button", { class: "primary", onclick: () => ask() });
  const list = el("ol");
  box.append(
    el("header", {}, el("h2", {}, "Recordings"), el("button", { class: "plain", "aria-label": "Close the list", onclick: () => show(false) }, "✕")),
    el("div", { class: "row" }, record, el("button", { onclick: () => look() }, "Refresh")), state, answer, list,
  );
  let reading = "";

  function show(isShown) {
    box.hidden = !isShown;
    button.setAttribute("aria-expanded", String(isShown));
    if (isShown) look();
  }
  button.addEventListener("click", () => show(box.hidden));

  async function ask() {
    say(answer, "");
    const { outcome, text } = await live.send("record", { action: live.status?.recording?.file ? "stop" : "start" });
    if (outcome !== "done") say(answer, text);
  }

  /** What a request answers, or null and the reason why there is none. */
  async function fetched(path) {
    try {
      const token = new URLSearchParams(location.search).get("token");
      const answered = await fetch(path, token ? { headers: { Authorization: `Bearer ${token}` } } : {});
      const said = await answered.json();
      if (answered.ok) return said;
      say(answer, said.detail ?? `the console answered ${answered.status}`);
    } catch {
      say(answer, "no connection to the console");
    }
    return null;
  }

  async function look() {
    const found = await fetched("/recordings");
    if (!found) return;
    const written = live.status?.recording?.file;
    list.replaceChildren(...found.map(({ name, bytes, written_s }) =>
      el("li", {}, el("button", { onclick: () => read(name), disabled: name === written, "data-recording": name },
        el("b", {}, name), el("small", {}, `${dateText(written_s)} · ${name === written ? "being written" : size(bytes)}`)))));
    if (!found.length) list.replaceChildren(el("li", { class: "doing" }, "The folder has no recording yet."));
  }

  async function read(name) {
    if (reading) return;
    reading = name;
    say(answer, "");
    update();
    const found = await fetched(`/recordings/${encodeURIComponent(name)}`);
    reading = "";
    update();
    if (!found) return;
    show(false);
    open(found);
  }

  function update() {
    const told = live.status?.recording ?? null;
    button.hidden = !told;
    if (!told) return;
    button.dataset.on = String(!!told.file);
    say(button, told.since_s ? "● Recording the cell" : told.file ? "Recording begins …" : "Recordings");
    say(record, told.file ? "End the recording" : "Record the cell");
    record.disabled = !!live.replay || !live.hello?.operator || !live.connection.isUp;
    say(state, reading ? `Reading ${reading} …` : told.since_s ? `${told.file} is being written.` : told.file ? "The recorder is starting." : told.text);
  }
  let before = "";
  live.addEventListener("status", () => {
    update();
    const written = JSON.stringify(live.status.recording);
    if (written !== before && !box.hidden) look();
    before = written;
  });
  for (const kind of ["line", "replay"]) live.addEventListener(kind, update);
}
