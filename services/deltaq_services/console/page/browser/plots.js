// Live plots of the last two minutes: what the operator watches, paused and saved on demand.

import { degrees, el, part, save, say } from "./dom.js";
import { csvCell } from "./event_log.js";
import { Series, SPAN_S } from "./series.js";

const DRAW_MS = 250;
const COLOURS = ["var(--line-1)", "var(--line-2)"];

/** The plots: title, unit, decimals, least span of the axis, lines {name, value()}. */
function plotsOf(live, scene, picture) {
  const robots = (read) => scene.robots.map((robot, index) => ({ name: robot.name, value: () => read(live.frame.robots[index]) }));
  const plots = [
    { title: "Clearance", unit: "cm", digits: 1, least: 10, from: 0, lines: [{ name: "nearest pair", value: () => 100 * (live.frame.nearest?.distance ?? NaN) }] },
    { title: "Admitted whole", unit: "%", digits: 0, least: 10, from: 0, to: 100, lines: robots((robot) => 100 * robot.admission) },
    { title: "Longest cycle", unit: "ms", digits: 0, least: 20, from: 0, lines: robots((robot) => 1000 * robot.longest_s) },
  ];
  if (!picture) return plots;
  return [
    { title: "Angle error", unit: "°", digits: 2, least: 2, from: 0, lines: [{ name: picture.view.name, value: () => degrees(picture.error()?.angle ?? NaN) }] },
    { title: "View distance", unit: "m", digits: 2, least: 0.2, lines: [{ name: picture.view.name, value: () => picture.error()?.distance ?? NaN }] },
    ...plots,
  ];
}

/** Draw one plot onto a canvas, as wide and high as its element. */
function draw(canvas, plot, now_s, styles) {
  const ratio = window.devicePixelRatio;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (!width) return;
  if (canvas.width !== Math.round(width * ratio)) Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  const ranges = plot.lines.map((line) => line.series.range(now_s - SPAN_S)).filter(Boolean);
  let least = plot.from ?? Math.min(...ranges.map(([low]) => low));
  let most = plot.to ?? Math.max(...ranges.map(([, high]) => high));
  if (!Number.isFinite(least) || !Number.isFinite(most)) [least, most] = [0, plot.least];
  if (most - least < plot.least) most = plot.from === undefined ? (least = (least + most - plot.least) / 2) + plot.least : least + plot.least;
  const pad = (most - least) * (plot.to === undefined ? 0.08 : 0.02);
  const [bottom, top] = [least - (plot.from === undefined ? pad : 0), most + pad];
  const x = (time) => width - ((now_s - time) / SPAN_S) * width;
  const y = (value) => height - 3 - ((value - bottom) / (top - bottom)) * (height - 6);
  pen.strokeStyle = styles.getPropertyValue("--rule");
  pen.lineWidth = 1;
  pen.beginPath();
  for (const at of [least, (least + most) / 2, most]) pen.moveTo(0, Math.round(y(at)) + 0.5), pen.lineTo(width, Math.round(y(at)) + 0.5);
  for (let back = 30; back < SPAN_S; back += 30) pen.moveTo(x(now_s - back), 0), pen.lineTo(x(now_s - back), height);
  pen.stroke();
  plot.lines.forEach((line, index) => {
    pen.strokeStyle = styles.getPropertyValue(COLOURS[index % 2].slice(4, -1));
    pen.lineWidth = 1.6;
    pen.setLineDash(index ? [5, 3] : []); // told apart without colour too
    pen.beginPath();
    let isDown = false;
    for (const [time, value] of line.series) {
      if (!Number.isFinite(value)) isDown = false;
      else if (isDown) pen.lineTo(x(time), y(value));
      else pen.moveTo(x(time), y(value)), (isDown = true);
    }
    pen.stroke();
  });
  pen.setLineDash([]);
  pen.fillStyle = styles.getPropertyValue("--faint");
  pen.font = "10px Roboto, system-ui, sans-serif";
  pen.fillText(most.toFixed(plot.digits && most < 100 ? 1 : 0), 3, Math.max(10, y(most) + 11));
}

export function livePlots(live, scene, picture, joints) {
  const plots = plotsOf(live, scene, picture);
  let pausedAt_s = null;
  const pause = el("button", { "aria-pressed": "false", onclick: () => toggle() }, "Pause");
  const head = el("header", {}, el("h2", {}, "Last two minutes"), pause,
    el("button", { onclick: () => save("deltaq-plots.csv", csv(), "text/csv") }, "CSV"), el("button", { onclick: () => png() }, "PNG"));
  const box = el("section", { class: "plots" }, head);
  for (const plot of plots) {
    plot.canvas = el("canvas", { role: "img", "aria-label": plot.title });
    plot.text = el("output");
    for (const line of plot.lines) line.series = new Series();
    box.append(el("figure", { class: "plot" }, el("figcaption", {}, plot.title, plot.text), plot.canvas));
  }
  part("figures").append(box, joints);

  function toggle() {
    pausedAt_s = pausedAt_s === null ? live.frame?.server_s ?? null : null;
    say(pause, pausedAt_s === null ? "Pause" : "Go on");
    pause.setAttribute("aria-pressed", String(pausedAt_s !== null));
  }

  function csv() {
    const lines = plots.flatMap((plot) => plot.lines.map((line) => ({ name: `${plot.title} ${line.name} [${plot.unit}]`, series: line.series })));
    const times = [...lines[0].series].map(([time]) => time);
    const columns = lines.map(({ series }) => new Map(series));
    const rows = times.map((time) => [new Date(time * 1000).toISOString(), ...columns.map((column) => column.get(time) ?? "")]);
    return [["time", ...lines.map(({ name }) => name)], ...rows].map((row) => row.map(csvCell).join(",")).join("\n");
  }

  function png() {
    const height = plots.reduce((sum, { canvas }) => sum + canvas.height + 26, 0);
    const sheet = el("canvas", { width: plots[0].canvas.width + 24, height: height + 12 });
    const pen = sheet.getContext("2d");
    const styles = getComputedStyle(document.documentElement);
    pen.fillStyle = styles.getPropertyValue("--panel");
    pen.fillRect(0, 0, sheet.width, sheet.height);
    let y = 6;
    for (const { title, unit, canvas } of plots) {
      pen.fillStyle = styles.getPropertyValue("--text");
      pen.font = "13px Roboto, system-ui, sans-serif";
      pen.fillText(`${title} [${unit}]`, 12, y + 16);
      pen.drawImage(canvas, 12, y + 22);
      y += canvas.height + 26;
    }
    sheet.toBlob((blob) => save("deltaq-plots.png", blob, "image/png"));
  }

  live.addEventListener("frame", ({ detail }) => {
    if (live.isStale() || live.replay) return; // what the camera sees then is not the cell
    for (const { lines } of plots) for (const { series, value } of lines) series.add(detail.server_s, value());
  });
  setInterval(() => {
    if (document.hidden || !live.frame) return;
    const styles = getComputedStyle(document.documentElement);
    for (const plot of plots) {
      draw(plot.canvas, plot, pausedAt_s ?? live.frame.server_s, styles);
      const texts = plot.lines.map(({ name, series }) => `${plot.lines.length > 1 ? `${name} ` : ""}${Number.isFinite(series.last) ? series.last.toFixed(plot.digits) : "–"}`);
      say(plot.text, `${texts.join("  ")} ${plot.unit}`);
    }
  }, DRAW_MS);
}
