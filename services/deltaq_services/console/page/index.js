// Starts the page. First what must work whatever becomes of the rest: STOP, the connection, the bar, and the events. The cell,
// and all that is drawn of it, is loaded after that; what goes wrong there is told in words.

import { Connection } from "./connection.js";
import { el, part, remember, remembered, say } from "./dom.js";
import { eventLog } from "./event_log.js";
import { Live } from "./live.js";
import { coverStale, lightOrDark, showBar } from "./status_bar.js";
import { bindStop, Stop } from "./stop.js";

const random = () => [...crypto.getRandomValues(new Uint32Array(4))].map((part) => part.toString(16)).join("-");
const PAGE = random(); // this load of the page

/** By which the console knows this tab again when its page is loaded anew. */
function session() {
  const kept = remembered("session", "", "sessionStorage") || random();
  remember("session", kept, "sessionStorage");
  return kept;
}

/** Address of the live WebSocket; a token in the page's address goes with it, and the operator's name. */
function liveUrl() {
  const token = new URLSearchParams(location.search).get("token");
  const query = new URLSearchParams({ ...(token ? { token } : {}), name: remembered("operator", ""), session: session(), page: PAGE });
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live?${query}`;
}

/** Say in place of the cell why it is not there; STOP and the bar go on. holder is the element of the 3D view. */
function tellUndrawn(holder, live, error) {
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

async function start(holder) {
  const connection = new Connection(liveUrl());
  const live = new Live(connection);
  const stop = new Stop(live, (state, title, text) => {
    part("stop").dataset.state = state;
    say(part("stop-title"), title);
    say(part("stop-answer"), live.replay && state === "ready" ? "stops the LIVE robots" : text);
  });
  live.addEventListener("replay", () => stop.update());
  bindStop(stop, part("stop"));
  connection.addEventListener("replaced", () => location.reload());
  connection.open();

  // for tests and the curious: what is behind the page
  window.deltaq = { live, stop };
  showBar(live, (name) => {
    remember("operator", name);
    connection.renew(liveUrl());
  });
  coverStale(live);
  eventLog(live);
  const look = lightOrDark();
  try {
    const { showCell } = await import("./cell_page.js");
    await showCell(holder, live, stop, look);
    part("console").dataset.ready = "true";
  } catch (error) {
    tellUndrawn(holder, live, error);
    part("console").dataset.ready = "undrawn";
  }
}

await start(part("cell-view"));
