// The advisor's options as ranked cards: a picture, scores by criterion, what is nearest, and a button that is held to go.

import { el, say } from "./dom.js";
import { holds } from "./hold.js";

const TITLES = {
  travel: "joint travel", clearance: "clearance", obstacle_clearance: "from obstacles", robot_clearance: "from other robots",
  self_clearance: "from itself", limits: "joint limits", speed: "hand speed", manipulability: "manipulability",
  condition: "condition", smallest_singular_value: "least singular value", effective_mass: "effective mass",
  effective_mass_rate: "effective mass rate", acceleration: "hand acceleration", torque: "joint torques", compliance: "compliance", potential_energy_partition: "potential energy partition",
  kinetic_energy: "kinetic energy", kinetic_energy_partition: "kinetic energy partition",
  relative_load: "load between hands", relative_energy: "energy between hands", relative_compliance: "compliance between hands",
  force: "hand force", deformation: "deformation", dexterity: "dexterity",
};
const FIRST = ["travel", "obstacle_clearance", "robot_clearance", "self_clearance"]; // what options are ranked by
const SEEN_MS = 700; // options that have just changed cannot be gone to yet: a press was meant for those before
const KINDS = { environment: "obstacles", robots: "other robots", self: "itself" };

/** A criterion's cost, 0 good to 1 bad, as a score of a hundred. */
export const score = (cost) => Math.round(100 * (1 - Math.min(1, Math.max(0, cost))));

function bar(name, cost) {
  return el("li", { title: `${TITLES[name] ?? name}: ${score(cost)} of 100` },
    el("span", {}, TITLES[name] ?? name), el("i", { style: `--score: ${score(cost)}%` }), el("b", {}, String(score(cost))));
}

/** Choosing two criteria that are weighed against one another; none: options are the least of their weighted sum. */
function tradeOffChoice() {
  const choice = (label) => el("select", { "aria-label": label });
  const [first, second] = [choice("Trade off"), choice("against")];
  const box = el("div", { class: "trade-off", hidden: true }, el("label", {}, "Trade off", first), el("label", {}, "against", second));
  let offered = "";
  const value = () => (first.value && second.value && first.value !== second.value ? [first.value, second.value] : null);

  /** Offer these criteria, those that are chosen staying so. */
  function offer(names) {
    if (names.join() === offered) return;
    offered = names.join();
    box.hidden = false;
    for (const select of [first, second]) {
      const chosen = select.value;
      select.replaceChildren(...["", ...names].map((name) => el("option", { value: name, selected: name === chosen }, name ? TITLES[name] ?? name : "nothing")));
    }
  }
  return { box, value, offer };
}

/** What options are, where two criteria are weighed against one another. */
const frontOf = ([first, second]) => `Pareto front of “${TITLES[first] ?? first}” and “${TITLES[second] ?? second}”`;

function near(name, { distance_m, pair }) {
  return el("p", { class: "doing" }, `${(100 * distance_m).toFixed(1)} cm to ${name}: ${pair.join(" and ")}`);
}

/** What the option is ranked by, and what it gains over where the robot is. */
function cost({ energy, energy_here }) {
  const gain = energy_here ? `, ${Math.round(100 * (1 - energy / energy_here))} % less than here` : "";
  return `cost ${energy.toFixed(3)}${gain}`;
}

/**
 * @param context {live, driven, wish, ways Ways, picture WayPicture, thumbnails, views}; ask(type, fields) sends a command.
 */
export function advisorCards({ live, driven, wish, ways, picture, thumbnails, views }, ask) {
  const doing = el("p", { class: "doing place", role: "status" });
  const bar_ = el("progress", { max: 1 });
  const tradeOff = tradeOffChoice();
  const leave = el("input", { type: "checkbox", onchange: () => (leaves = leave.checked) });
  const mayLeave = el("label", { class: "may-leave" }, leave, "Hands may leave their pose on the way, and return");
  const again = el("button", { onclick: () => ask("advise", { action: "ask", trade_off: tradeOff.value(), hands_may_leave: leave.checked }) }, "Look again");
  const cancel = el("button", { onclick: cancelled }, "Cancel");
  const list = el("ol", { class: "cards" });
  const box = el("section", { class: "advisor" }, el("h2", {}, "Options"), doing, bar_, tradeOff.box, mayLeave, el("div", { class: "row" }, again, cancel), list);
  let drawn = "";
  let changed_ms = 0;
  let kept = new Map(); // rank -> what changes on its card
  let leaves = null; // what the operator chose and has not asked for yet; null: nothing

  function cancelled() {
    wish.releaseAll();
    picture.show(driven.name, null);
    ask("advise", { action: "cancel" });
  }

  function card(way) {
    const go = el("button", { class: "primary hold-to-go", disabled: !way.points.length }, way.points.length ? "Hold to go" : "No path there");
    const source = `option ${way.rank}`;
    holds(go, () => wish.hold(source, { option: way.rank }), () => wish.release(source));
    const driven_ = el("progress", { max: 1, value: 0, "aria-label": `Path to option ${way.rank}` });
    const costs = Object.entries(way.costs);
    const first = [...new Set([...(live.robot(driven.name)?.search?.trade_off ?? []), ...FIRST])];
    const rest = costs.filter(([name]) => !first.includes(name));
    const item = el("li", { class: "card-option", "data-option": way.rank, tabindex: 0 },
      el("header", {}, el("b", {}, `${way.rank}`), el("span", {}, cost(way)), el("small", {}, `${way.nearest_limit} ${Math.round(100 * way.limit_share)} % from its limit`)),
      thumbnails.of(views.find(({ name }) => name === driven.name), way.q),
      el("ul", { class: "scores" }, ...first.filter((name) => name in way.costs).map((name) => bar(name, way.costs[name]))),
      ...Object.entries(KINDS).filter(([kind]) => kind in way.near).map(([kind, name]) => near(name, way.near[kind])),
      el("p", { class: "why", hidden: !way.hands_leave }, "The hand leaves its pose on the way and returns to it."),
      el("details", {}, el("summary", {}, "All criteria"), el("ul", { class: "scores" }, ...rest.map(([name, cost]) => bar(name, cost)))),
      el("p", { class: "why", hidden: !way.why_not }, way.why_not),
      go, driven_,
    );
    const show = () => picture.show(driven.name, way);
    const hide = () => wish.isActive || picture.show(driven.name, null);
    for (const kind of ["pointerenter", "focusin"]) item.addEventListener(kind, show);
    for (const kind of ["pointerleave", "focusout"]) item.addEventListener(kind, hide);
    kept.set(way.rank, { go, progress: driven_, has: !!way.points.length });
    return item;
  }

  /** Cards are made anew only where the options have changed: a button that is held must stay. */
  function fill() {
    const offered = ways.of(driven.name, "advisor");
    const told = JSON.stringify([driven.name, offered]);
    if (told === drawn || wish.isActive) return;
    drawn = told;
    changed_ms = performance.now();
    setTimeout(show, SEEN_MS);
    kept = new Map();
    picture.show(driven.name, null);
    if (offered.length) tradeOff.offer(Object.keys(offered[0].costs));
    list.replaceChildren(...offered.map(card));
  }

  function show() {
    const robot = live.robot(driven.name);
    box.hidden = robot?.mode !== "advisor";
    if (box.hidden) return;
    fill();
    const { search, lease } = robot;
    const cannot = live.cannotDrive(driven.name);
    const front = search?.trade_off && !search.is_busy ? `; ${frontOf(search.trade_off)}` : "";
    say(doing, search?.is_busy ? `${search.doing || "searching"}, ${search.trials} configuration${search.trials === 1 ? "" : "s"} tried` : robot.driving + front);
    bar_.style.visibility = search?.is_busy ? "" : "hidden";
    bar_.value = search?.done ?? 0;
    if (leaves === !!search?.hands_may_leave) leaves = null;
    leave.checked = leaves ?? !!search?.hands_may_leave;
    again.disabled = cancel.disabled = leave.disabled = !!cannot || !lease.mine;
    const isNew = performance.now() - changed_ms < SEEN_MS;
    for (const [rank, { go, progress, has }] of kept) {
      const isOn = search?.way === rank;
      if (!wish.isActive) delete go.dataset.held;
      go.disabled = !!cannot || !has || isNew || (isOn && search.arrived);
      say(go, !has ? "No path there" : isOn && search.arrived ? "The robot is here" : isOn && search.driven > 0 ? "Hold to continue" : "Hold to go");
      progress.style.visibility = isOn ? "" : "hidden";
      progress.value = isOn ? (search.arrived ? 1 : search.driven) : 0;
    }
  }
  ways.addEventListener("change", show);
  return { box, show };
}
