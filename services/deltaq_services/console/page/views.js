// Where one looks from: presets and all of the cell.

import { THREE } from "./vendor/three.js";
import { el, part } from "./dom.js";
import { cross, dot } from "./drag_math.js";

const FROM = [0.74, 0.62, 0.27]; // where an operator stands, as seen from the work
const MARGIN = 0.96; // of half the picture
const PART_M = 1.2; // longer ones carry an arm
const THING_M = 2.5;

/** Corners of the boxes around the parts of an arm and its tools, in the world [m]; beams and columns that carry it are left out. */
function cornersOf(view) {
  const carriage = view.robot.joints.findIndex(({ kind }) => kind === "revolute") - 1; // -1 is the base
  return [...view.bodies.values()].filter(({ group }) => group.userData.joint >= carriage).flatMap(({ group, parts }) =>
    parts.flatMap(({ geometry, matrix }) => {
      geometry.boundingBox ?? geometry.computeBoundingBox();
      const { min, max } = geometry.boundingBox;
      if (min.distanceTo(max) > PART_M) return [];
      const place = group.matrix.clone().multiply(new THREE.Matrix4().fromArray(matrix));
      return [...Array(8).keys()].map((k) => new THREE.Vector3(k & 1 ? max.x : min.x, k & 2 ? max.y : min.y, k & 4 ? max.z : min.z).applyMatrix4(place).toArray());
    }));
}

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
    const at = work();
    const things = scene.structure
      .filter(({ name, size, T_world: T }) => name !== "structure/floor" && Math.max(...size) < THING_M && Math.hypot(T[12] - at.x, T[13] - at.y) < THING_M)
      .map(({ T_world: T }) => [T[12], T[13], T[14]]);
    return [...views.flatMap(cornersOf), ...things];
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

// Where a camera has to stand so that it sees all of some points, as near as that allows.

const unit = (a) => a.map((value) => value / Math.hypot(...a));

/**
 * Eye and target of a camera that looks from the direction `from` (towards it, in the world, not straight down).
 * @param points [[x, y, z], ...] in m, at least one; wide, high tangents of half the angles of view.
 */
export function framed(points, from, wide, high) {
  const back = unit(from);
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  const seen = points.map((point) => [dot(point, right), dot(point, up), dot(point, back)]);
  // of each side of the picture the point that is nearest to it bounds where the eye may be
  const [across, upright] = [[0, wide], [1, high]].map(([k, tangent]) => {
    const [most, least] = [1, -1].map((sign) => Math.max(...seen.map((point) => sign * point[k] + tangent * point[2])));
    return { middle: (most - least) / 2, depth: (most + least) / (2 * tangent) };
  });
  const depth = Math.max(across.depth, upright.depth);
  const target = seen.reduce((sum, point) => sum + point[2], 0) / seen.length;
  const at = (far) => [0, 1, 2].map((k) => across.middle * right[k] + upright.middle * up[k] + far * back[k]);
  return { eye: at(depth), target: at(Math.min(target, depth - 0.5)) };
}
