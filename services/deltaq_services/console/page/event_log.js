// The log of events under the picture: newest first, filtered by kind and text, saved as CSV.

import { dateText, el, part, save, say } from "./dom.js";

const MOST = 500;
const KINDS = ["stop", "verdict", "phase", "lease", "link", "client", "recording", "view"];

/** A cell of a CSV file; what a spreadsheet would take for a formula is quoted. */
export function csvCell(value) {
  const text = String(value ?? "");
  const safe = /^[=+\-@\t\r]/.test(text) && Number.isNaN(Number(text)) ? `'${text}` : text;
  return /[",\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}

export function eventLog(live) {
  const events = [];
  const list = el("ol", { class: "lines" });
  const filter = el("input", { type: "search", placeholder: "Filter", "aria-label": "Filter events" });
  const kinds = el("select", { "aria-label": "Kind of event" }, el("option", { value: "" }, "all"), ...KINDS.map((kind) => el("option", { value: kind }, kind)));
  const newest = el("span", { class: "newest" });
  const log = part("log");
  const open = el("button", { class: "opener", "aria-expanded": "false", onclick: () => toggle() }, el("b", {}, "Events"), newest);
  const tools = el("div", { class: "tools" }, filter, kinds, el("button", { onclick: () => save("deltaq-events.csv", csv(), "text/csv") }, "Save CSV"));
  log.append(el("header", {}, open, tools), list);

  const time = (event) => dateText(event.time_s).slice(11);
  const words = (event) => `${event.robot ? `${event.robot}: ` : ""}${event.text}${event.count > 1 ? ` (${event.count} times)` : ""}`;
  const line = (event) => el("li", { "data-kind": event.kind }, el("time", {}, time(event)), el("i", {}, event.kind), el("span", {}, words(event)));
  const wanted = () => events.filter((event) => (!kinds.value || event.kind === kinds.value) && words(event).toLowerCase().includes(filter.value.toLowerCase()));

  function csv() {
    const rows = wanted().map((event) => [new Date(event.time_s * 1000).toISOString(), event.kind, event.robot, event.text, event.count]);
    return [["time", "kind", "robot", "text", "count"], ...rows].map((row) => row.map(csvCell).join(",")).join("\n");
  }

  function toggle() {
    const isOpen = log.dataset.open !== "true";
    log.dataset.open = String(isOpen);
    open.setAttribute("aria-expanded", String(isOpen));
    show();
  }

  function show() {
    const last = events[0];
    say(newest, last ? `${time(last)}  ${words(last)}` : "nothing yet");
    if (log.dataset.open === "true") list.replaceChildren(...wanted().slice(0, 200).map(line));
  }

  let isAsked = false;
  live.addEventListener("event", ({ detail }) => {
    events.unshift(detail);
    events.length = Math.min(events.length, MOST);
    if (isAsked) return; // many at once are drawn once
    isAsked = true;
    requestAnimationFrame(() => {
      isAsked = false;
      show();
    });
  });
  live.connection.addEventListener("up", () => events.splice(0)); // the console tells its newest lines again
  filter.addEventListener("input", show);
  kinds.addEventListener("change", show);
  show();
}
