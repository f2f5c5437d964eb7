// The axes along which a hand is jogged, at the hand while it is: red x, green y, blue z, of the world or of the tool.

import { THREE } from "./vendor/three.js";

export const COLOURS = ["#ff4f5e", "#62dfae", "#4fb3ea"];
const LENGTH_M = 0.22;

function arrows() {
  const group = new THREE.Group();
  COLOURS.forEach((color, axis) => {
    const paint = new THREE.MeshBasicMaterial({ color, toneMapped: false, fog: false, depthTest: false, transparent: true });
    const shapes = [new THREE.CylinderGeometry(0.007, 0.007, LENGTH_M, 8).translate(0, LENGTH_M / 2, 0), new THREE.ConeGeometry(0.022, 0.06, 12).translate(0, LENGTH_M, 0)];
    const arrow = new THREE.Group().add(...shapes.map((shape) => new THREE.Mesh(shape, paint)));
    for (const mesh of arrow.children) mesh.renderOrder = 9;
    arrow.rotation.set(...[[0, 0, -Math.PI / 2], [0, 0, 0], [Math.PI / 2, 0, 0]][axis]);
    group.add(arrow);
  });
  group.visible = group.matrixAutoUpdate = false;
  return group;
}

/** Draw them on the stage; returns the groups, one a hand. */
export function jogAxes({ stage, driven, wish, views }) {
  const groups = Array.from({ length: Math.max(...views.map(({ robot }) => robot.tools.length)) }, arrows);
  stage.marks.add(...groups);
  stage.beforeEach(() => {
    const isOn = wish.isActive && driven.isJogged && !driven.isByJoints;
    const view = views.find(({ name }) => name === driven.name);
    groups.forEach((group, index) => {
      const hand = driven.hands[index];
      const isShown = isOn && hand !== undefined && (!driven.hands.includes(driven.moved) || driven.moved === hand);
      if (isShown || group.visible) stage.ask();
      group.visible = isShown;
      if (!isShown) return;
      const T = view.toolPose(index);
      if (driven.frame === "tool") group.matrix.fromArray(T);
      else group.matrix.makeTranslation(T[12], T[13], T[14]);
      group.matrixWorldNeedsUpdate = true;
    });
  });
  return groups;
}
