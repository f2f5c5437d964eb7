// Joints as bars between their limits: where each is, and where it would come to rest; and where the tools are in the world.

import { el, jointText, poseText, say } from "./dom.js";

const NEAR = 0.06; // share of the range at which a limit is called near

/** @param views RobotView of each robot, in the order of the scene. */
export function jointBars(live, scene, views) {
  const box = el("section", { class: "joints" }, el("h2", {}, "Joints, and tools in the world"));
  const tools = [];
  const robots = scene.robots.map((robot) => {
    const rows = robot.joints.map((joint) => {
      const [mark, rest, value] = [el("i", { class: "at" }), el("i", { class: "rest" }), el("output")];
      const row = el("div", { class: "joint", title: `${jointText(joint.lower, joint.unit)} to ${jointText(joint.upper, joint.unit)}` },
        el("b", {}, joint.name.toUpperCase()), el("div", { class: "range" }, rest, mark), value);
      return { joint, row, mark, rest, value };
    });
    const poses = robot.tools.map((tool) => el("output", { class: "tool-pose", title: `${tool.name} of ${robot.name}, in the world` }));
    tools.push(poses);
    box.append(el("div", { class: "joint-group" }, el("h3", {}, robot.name), ...poses, ...rows.map(({ row }) => row)));
    return rows;
  });
  const share = (joint, q) => Math.min(1, Math.max(0, (q - joint.lower) / (joint.upper - joint.lower)));
  setInterval(() => {
    if (!live.shown || document.hidden) return;
    robots.forEach((rows, index) => {
      const { q, rest: q_rest } = live.shown.robots[index];
      tools[index].forEach((output, hand) => say(output, poseText(views[index].toolPose(hand))));
      rows.forEach(({ joint, row, mark, rest, value }, k) => {
        const [at, end] = [share(joint, q[k]), share(joint, q_rest[k])];
        mark.style.left = `${100 * at}%`;
        rest.style.left = `${100 * Math.min(at, end)}%`;
        rest.style.width = `${100 * Math.abs(end - at)}%`;
        row.dataset.near = String(at < NEAR || at > 1 - NEAR);
        say(value, jointText(q[k], joint.unit));
      });
    });
  }, 120);
  return box;
}
