// What the page says in place of the cell where that cannot be fetched or drawn. STOP and the bar go on.

import { el, say } from "./dom.js";

/** @param holder element of the 3D view; error why there is none. */
export function tellUndrawn(holder, live, error) {
  console.error(error);
  live.isUndrawn = true; // locks whatever was put up before it went wrong
  const robots = el("dl");
  const rows = new Map();
  holder.replaceChildren(
    el("section", { class: "undrawn", role: "alert" },
      el("h2", {}, "The cell cannot be shown"),
      el("p", {}, error.message),
      el("p", {}, "STOP works. Nothing can be driven from this page until the cell is shown."),
      robots,
      el("button", { class: "primary", onclick: () => location.reload() }, "Load the page again")),
  );

  function show() {
    for (const [name, robot] of Object.entries(live.status?.robots ?? {})) {
      if (!rows.has(name)) {
        rows.set(name, el("dd"));
        robots.append(el("dt", {}, name), rows.get(name));
      }
      say(rows.get(name), live.connection.isUp ? `${robot.text}. ${robot.remedy}`.trim() : "no connection to the console");
    }
  }
  for (const kind of ["status", "line"]) live.addEventListener(kind, show);
  show();
}
