// Where one looks from: presets and all of the cell.

import { THREE } from "nicegui-scene";
import { el, part } from "./dom.js";
import { framed } from "./framing.js";

const FROM = [0.74, 0.62, 0.27]; // where an operator stands, as seen from the work
const MARGIN = 0.92; // of half the picture
const ARM_M = 0.22; // about half as thick as an arm
const THING_M = 2.5;

export function viewBar(stage, scene, views) {
  const box = new THREE.Box3().setFromObject(stage.solid);
  const leader = views.find((view) => !view.robot.camera) ?? views[0];
  const middle = box.getCenter(new THREE.Vector3());

  /** What moves is what one looks at: the robots' hands, and a little of what is around them. */
  function work() {
    const hands = views.map((view) => view.toolPose()).map((T) => new THREE.Vector3(T[12], T[13], T[14]));
    return hands.reduce((sum, hand) => sum.add(hand), new THREE.Vector3()).divideScalar(hands.length);
  }
  /** What an operator watches: arms and tools, and what stands near them, without the posts and beams that carry them. */
  function watched() {
    const arms = views.flatMap((view) => {
      const { joints, tools } = view.robot;
      const carriage = Math.max(-1, joints.findIndex(({ kind }) => kind === "revolute") - 1); // -1 is the base
      const moved = [...joints.keys()].slice(carriage + 1).map((index) => view.group(index).matrix.elements);
      return [view.group(carriage).matrix.elements, ...moved, ...tools.map((_, index) => view.toolPose(index))];
    }).flatMap((T) => [-1, 1].flatMap((side) => [0, 1, 2].map((k) => [0, 1, 2].map((axis) => T[12 + axis] + (axis === k ? side * ARM_M : 0)))));
    const at = work();
    const things = scene.structure
      .filter(({ name, size, T_world: T }) => name !== "structure/floor" && Math.max(...size) < THING_M && Math.hypot(T[12] - at.x, T[13] - at.y) < THING_M)
      .map(({ T_world: T }) => [T[12], T[13], T[14]]);
    return [...arms, ...things];
  }

  const presets = {
    Operator(glide) {
      const high = MARGIN * Math.tan(THREE.MathUtils.degToRad(stage.camera.fov / 2));
      const { eye, target } = framed(watched(), FROM, high * stage.camera.aspect, high);
      stage.view(eye, target, glide);
    },
    Top(glide) {
      const at = work();
      stage.view([at.x + 0.01, at.y, box.max.z + 5], [at.x, at.y, 0.5], glide);
    },
    "Leader's hand"(glide) {
      const T = leader.toolPose();
      stage.view([T[12] + 1.25, T[13] + 1.0, T[14] + 0.55], [T[12], T[13], T[14] + 0.12], glide);
    },
    All(glide) {
      stage.view([middle.x + 5, middle.y + 4, middle.z + 2.2], [middle.x, middle.y, middle.z], false);
      stage.fit(box, glide);
    },
  };
  for (const [name, go] of Object.entries(presets)) part("views").append(el("button", { onclick: () => go(true) }, name));
  presets.Operator(false);
  return presets;
}
