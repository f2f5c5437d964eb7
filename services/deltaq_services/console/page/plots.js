// Live plots of the last two minutes: what the operator watches, paused and saved on demand.

import { degrees, el, part, remember, remembered, save, say } from "./dom.js";
import { csvCell } from "./event_log.js";

const DRAW_MS = 250;
const COLOURS = ["--line-1", "--line-2"];
const DASH = [5, 3];
const [GUTTER, TIMES, EDGE] = [30, 13, 6]; // px for numbers at the axis, for times below it, and half a number's height
const SHEET = { width: 720, height: 110, title: 24, scale: 2 }; // of a saved picture, a plot each

/** The plots: title, unit, decimals, least span of the axis, lines {name, value()}. */
function plotsOf(live, scene, picture) {
  const robots = (read) => scene.robots.map((robot, index) => ({ name: robot.name, value: () => read(live.frame.robots[index]) }));
  const plots = [
    { title: "Clearance", unit: "cm", digits: 1, least: 10, from: 0, lines: [{ name: "nearest pair", value: () => 100 * (live.frame.nearest?.distance ?? NaN) }] },
    { title: "Admitted", unit: "%", digits: 0, least: 10, from: 0, to: 100, lines: robots((robot) => 100 * robot.admission) },
    { title: "Longest cycle", unit: "ms", digits: 0, least: 20, from: 0, lines: robots((robot) => 1000 * robot.longest_s) },
  ];
  if (!picture) return plots;
  const followers = (read) => picture.followers.map((follower) => ({ name: follower.name, value: () => read(picture.error(follower)) }));
  return [
    { title: "Angle error", unit: "°", digits: 2, least: 2, from: 0, lines: followers((error) => degrees(error?.angle ?? NaN)) },
    { title: "View distance", unit: "m", digits: 2, least: 0.2, lines: followers((error) => error?.distance ?? NaN) },
    ...plots,
  ];
}

/** Plots of single signals, which are shown once they are chosen: each joint, and where each tool is in the world. */
function signalsOf(live, views) {
  return views.flatMap(({ name, robot }, index) => [
    ...robot.joints.map((joint, k) => {
      const [unit, scale] = joint.unit === "rad" ? ["°", 180 / Math.PI] : ["mm", 1000];
      return { title: `${name} ${joint.name.toUpperCase()}`, unit, digits: 1, least: 2, lines: [{ name, value: () => scale * live.frame.robots[index].q[k] }] };
    }),
    ...robot.tools.flatMap((tool, hand) => ["X", "Y", "Z"].map((axis, k) => (
      { title: `${name} ${robot.tools.length > 1 ? `${tool.name} ` : ""}${axis}`, unit: "mm", digits: 0, least: 20, lines: [{ name, value: () => 1000 * views[index].toolPose(hand)[12 + k] }] }))),
  ]);
}

/** The range of a plot's axis [least, most]: of its values since `from_s`, and no narrower than is worth looking at. */
export function axisOf(plot, from_s) {
  const ranges = plot.lines.map((line) => line.series.range(from_s)).filter(Boolean);
  let least = plot.from ?? Math.min(...ranges.map(([low]) => low));
  let most = plot.to ?? Math.max(...ranges.map(([, high]) => high));
  if (!Number.isFinite(least) || !Number.isFinite(most)) [least, most] = [plot.from ?? 0, (plot.from ?? 0) + plot.least];
  if (most - least < plot.least) most = plot.from === undefined ? (least = (least + most - plot.least) / 2) + plot.least : least + plot.least;
  return [least, most];
}

/** A number at an axis from `least` to `most`, with as many decimals as tell them apart. */
export function axisText(value, [least, most]) {
  return value.toFixed(Math.min(2, Math.max(0, Math.ceil(-Math.log10((most - least) / 5)))));
}

/** Draw one plot into a box of the pen, with numbers at its axis, and times below it if there is room for them. */
function draw(pen, [left, top, width, height], plot, now_s, styles, hasTimes) {
  const axis = axisOf(plot, now_s - SPAN_S);
  const [least, most] = axis;
  const [x0, bottom] = [left + GUTTER, top + height - (hasTimes ? TIMES : 0)];
  const x = (time) => left + width - ((now_s - time) / SPAN_S) * (width - GUTTER);
  const y = (value) => bottom - EDGE - ((value - least) / (most - least)) * (bottom - top - 2 * EDGE);
  pen.font = "10px Roboto, system-ui, sans-serif";
  pen.strokeStyle = styles.getPropertyValue("--rule");
  pen.fillStyle = styles.getPropertyValue("--soft");
  pen.lineWidth = 1;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  pen.beginPath();
  for (const at of [least, (least + most) / 2, most]) pen.moveTo(x0, Math.round(y(at)) + 0.5), pen.lineTo(left + width, Math.round(y(at)) + 0.5);
  for (let back = 0; back <= SPAN_S; back += 30) pen.moveTo(x(now_s - back), top + EDGE), pen.lineTo(x(now_s - back), bottom - EDGE);
  pen.stroke();
  for (const at of [least, most]) pen.fillText(axisText(at, axis), x0 - 4, y(at));
  if (hasTimes) {
    pen.textBaseline = "alphabetic";
    for (let back = 0; back <= SPAN_S; back += 30) {
      pen.textAlign = back === 0 ? "right" : back === SPAN_S ? "left" : "center";
      pen.fillText(back ? `−${back} s` : "now", x(now_s - back), top + height - 1);
    }
  }
  pen.save();
  pen.beginPath();
  pen.rect(x0, top, width - GUTTER, bottom - top);
  pen.clip();
  plot.lines.forEach((line, index) => {
    pen.strokeStyle = styles.getPropertyValue(COLOURS[index % 2]);
    pen.lineWidth = 1.6;
    pen.setLineDash(index ? DASH : []); // told apart without colour too
    pen.beginPath();
    let isDown = false;
    for (const [time, value] of line.series) {
      if (!Number.isFinite(value)) isDown = false;
      else if (isDown) pen.lineTo(x(time), y(value));
      else pen.moveTo(x(time), y(value)), (isDown = true);
    }
    pen.stroke();
  });
  pen.restore();
}

/** The pen of a canvas as wide and high as its element, cleared; null where that is not shown. */
function penOf(canvas) {
  const ratio = window.devicePixelRatio;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width) return null;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}

const lastOf = (plot, { series }) => (Number.isFinite(series.last) ? series.last.toFixed(plot.digits) : "–");

/** A piece of a line, as the legend shows it. */
function sample(index) {
  return el("svg", { viewBox: "0 0 18 6", class: "sample", "aria-hidden": "true" }, el("line", { x1: 0, y1: 3, x2: 18, y2: 3, "stroke-dasharray": index ? DASH.join(" ") : "none" }));
}

export function livePlots(live, scene, picture, views, joints) {
  const usual = plotsOf(live, scene, picture);
  const all = [...usual, ...signalsOf(live, views)];
  let plots = []; // that are shown
  let pausedAt_s = null;
  const pause = el("button", { "aria-pressed": "false", onclick: () => toggle() }, "Pause");
  const head = el("header", {}, el("h2", {}, "Last 2 min"), pause,
    el("button", { onclick: () => save("deltaq-plots.csv", csv(), "text/csv") }, "CSV"), el("button", { onclick: () => png() }, "PNG"));
  const choose = el("select", { "aria-label": "Show or hide a plot" });
  const box = el("section", { class: "plots" }, head);
  for (const plot of all) {
    plot.canvas = el("canvas", { role: "img", "aria-label": plot.title });
    for (const line of plot.lines) Object.assign(line, { series: new Series(), text: el("output") });
    const legend = plot.lines.map(({ name, text }, index) => el("span", { class: "told", "data-line": index },
      ...(plot.lines.length > 1 ? [sample(index), name] : []), text, index === plot.lines.length - 1 ? plot.unit : ""));
    plot.box = el("figure", { class: "plot" }, el("figcaption", {}, el("b", {}, plot.title), ...legend), plot.canvas);
    box.append(plot.box);
  }
  box.append(choose);
  part("figures").append(box, joints);

  function show(titles) {
    plots = all.filter(({ title }) => titles.includes(title));
    for (const plot of all) {
      plot.box.hidden = !plots.includes(plot);
      plot.hasTimes = plot === plots.at(-1);
      plot.box.dataset.times = String(plot.hasTimes);
    }
    choose.replaceChildren(el("option", { value: "" }, "Show or hide a plot …"), ...all.map(({ title }) => el("option", { value: title }, `${titles.includes(title) ? "✓ " : "\u2003"}${title}`)));
  }
  choose.addEventListener("change", () => {
    const shown = plots.map(({ title }) => title);
    const titles = shown.includes(choose.value) ? shown.filter((title) => title !== choose.value) : [...shown, choose.value];
    remember("plots", titles);
    show(titles);
  });
  show(remembered("plots", usual.map(({ title }) => title)));

  function toggle() {
    pausedAt_s = pausedAt_s === null ? live.frame?.server_s ?? null : null;
    say(pause, pausedAt_s === null ? "Pause" : "Go on");
    pause.setAttribute("aria-pressed", String(pausedAt_s !== null));
  }

  function csv() {
    const lines = [...new Set([...usual, ...plots])].flatMap((plot) => plot.lines.map((line) => ({ name: `${plot.title} ${line.name} [${plot.unit}]`, series: line.series })));
    const times = [...lines[0].series].map(([time]) => time);
    const columns = lines.map(({ series }) => new Map(series));
    const rows = times.map((time) => [new Date(time * 1000).toISOString(), ...columns.map((column) => column.get(time) ?? "")]);
    return [["time", ...lines.map(({ name }) => name)], ...rows].map((row) => row.map(csvCell).join(",")).join("\n");
  }

  /** All plots below one another, with titles, numbers, legends and times, for paper: in the look of the page. */
  function png() {
    const { width, height, title: high, scale } = SHEET;
    const sheet = el("canvas", { width: scale * width, height: scale * plots.length * height });
    const pen = sheet.getContext("2d");
    const styles = getComputedStyle(document.documentElement);
    pen.scale(scale, scale);
    pen.fillStyle = styles.getPropertyValue("--panel");
    pen.fillRect(0, 0, width, plots.length * height);
    plots.forEach((plot, row) => {
      const top = row * height;
      draw(pen, [12, top + high, width - 24, height - high - 4], plot, pausedAt_s ?? live.frame.server_s, styles, true);
      Object.assign(pen, { textBaseline: "alphabetic", textAlign: "left", font: "13px Roboto, system-ui, sans-serif", fillStyle: styles.getPropertyValue("--text") });
      pen.fillText(`${plot.title} [${plot.unit}]`, 12, top + 17);
      pen.textAlign = "right";
      let right = width - 12;
      [...plot.lines.keys()].reverse().forEach((index) => {
        const line = plot.lines[index];
        const text = `${line.name} ${lastOf(plot, line)}`;
        pen.fillText(text, right, top + 17);
        right -= pen.measureText(text).width + 26;
        pen.strokeStyle = styles.getPropertyValue(COLOURS[index % 2]);
        pen.setLineDash(index ? DASH : []);
        pen.lineWidth = 2;
        pen.beginPath();
        pen.moveTo(right, top + 13), pen.lineTo(right + 20, top + 13);
        pen.stroke();
        pen.setLineDash([]);
        right -= 14;
      });
    });
    sheet.toBlob((blob) => save("deltaq-plots.png", blob, "image/png"));
  }

  live.addEventListener("frame", ({ detail }) => {
    if (live.isStale() || live.replay) return; // what the camera sees then is not the cell
    for (const { lines } of new Set([...usual, ...plots])) for (const { series, value } of lines) series.add(detail.server_s, value());
  });
  setInterval(() => {
    if (document.hidden || !live.frame) return;
    const styles = getComputedStyle(document.documentElement);
    for (const plot of plots) {
      const pen = penOf(plot.canvas);
      if (pen) draw(pen, [0, 0, plot.canvas.clientWidth, plot.canvas.clientHeight], plot, pausedAt_s ?? live.frame.server_s, styles, plot.hasTimes);
      for (const line of plot.lines) say(line.text, lastOf(plot, line));
    }
  }, DRAW_MS);
}

// Numbers over the last two minutes, kept in a ring.

export const SPAN_S = 120;
const STEP_S = 0.1;

export class Series {
  constructor() {
    this.size = Math.ceil(SPAN_S / STEP_S);
    this.times = new Float64Array(this.size);
    this.values = new Float64Array(this.size);
    this.count = 0;
  }

  /** Add a value at a time [s]; more than ten a second are left out. */
  add(time_s, value) {
    if (this.count && time_s - this.newest_s < STEP_S) return;
    this.times[this.count % this.size] = time_s;
    this.values[this.count % this.size] = value;
    this.count += 1;
  }

  get newest_s() {
    return this.count ? this.times[(this.count - 1) % this.size] : NaN;
  }

  get last() {
    return this.count ? this.values[(this.count - 1) % this.size] : NaN;
  }

  /** [time, value] from the oldest to the newest. */
  *[Symbol.iterator]() {
    for (let k = Math.max(0, this.count - this.size); k < this.count; k++) {
      yield [this.times[k % this.size], this.values[k % this.size]];
    }
  }

  /** Least and greatest finite value not older than `from_s`; null without any. */
  range(from_s) {
    let [least, most] = [Infinity, -Infinity];
    for (const [time, value] of this) {
      if (time < from_s || !Number.isFinite(value)) continue;
      least = Math.min(least, value);
      most = Math.max(most, value);
    }
    return least <= most ? [least, most] : null;
  }
}
