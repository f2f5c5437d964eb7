// Where one looks from: presets and all of the cell.

import { THREE } from "nicegui-scene";
import { el, part } from "./dom.js";

export function viewBar(stage, scene, views) {
  const box = new THREE.Box3().setFromObject(stage.solid);
  const leader = views.find((view) => !view.robot.camera) ?? views[0];
  const middle = box.getCenter(new THREE.Vector3());

  /** What moves is what one looks at: the robots' hands, and a little of what is around them. */
  function work() {
    const hands = views.map((view) => view.toolPose()).map((T) => new THREE.Vector3(T[12], T[13], T[14]));
    return hands.reduce((sum, hand) => sum.add(hand), new THREE.Vector3()).divideScalar(hands.length);
  }
  const presets = {
    Operator(glide) {
      const at = work();
      const wide = Math.max(1, 1.2 / stage.camera.aspect);
      stage.view([at.x + 4.9 * wide, at.y + 3.8 * wide, at.z + 1.3 * wide], [at.x - 0.14, at.y - 0.45, at.z - 0.32], glide);
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
