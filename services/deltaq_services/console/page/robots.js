// The robots and the structure as three.js objects: one merged mesh a link, placed by forward kinematics.

import { THREE } from "./vendor/three.js";
import { Kinematics } from "./kinematics.js";
import { merge } from "./meshes.js";

const IDENTITY = new THREE.Matrix4().toArray();

/** Colours of scene.json are as a screen shows them. */
function colourOf(rgba) {
  return new THREE.Color().setRGB(rgba[0], rgba[1], rgba[2], THREE.SRGBColorSpace);
}

/** One robot: a group a joint, and one for its base. */
export class RobotView {
  /**
   * @param robot one robot of scene.json.
   * @param store MeshStore.
   * @param material of all its links.
   */
  static async make(robot, store, material) {
    const view = new RobotView(robot);
    const carried = Map.groupBy(robot.links, (link) => `${link.joint} ${link.tool ?? ""}`);
    await Promise.all([...carried.values()].map((links) => view._addLinks(links, store, material)));
    view.place(view.q);
    return view;
  }

  constructor(robot) {
    this.name = robot.name;
    this.robot = robot;
    this.kinematics = new Kinematics(robot);
    this.root = new THREE.Group();
    this.root.name = robot.name;
    this._groups = [-1, ...robot.joints.keys()].map((joint) => {
      const group = new THREE.Group();
      group.matrixAutoUpdate = false;
      group.userData.joint = joint;
      if (joint < 0) group.matrix.fromArray(robot.T_world_base);
      this.root.add(group);
      return group;
    });
    this.bodies = new Map(); // body's name in the gate -> {geometry, joint, matrix} of its parts
    this.q = robot.joints.map(() => 0);
    this.coupled = null;
    this._ghosts = [];
  }

  /** Show one of its exchangeable tools, none (""), or all where it is not known which it has (null). */
  couple(tool) {
    if (tool === this.coupled) return;
    this.coupled = tool;
    for (const child of this._groups.flatMap((group) => group.children)) {
      if (child.userData.tool) child.visible = tool === null || tool === child.userData.tool;
    }
    this._ghosts.forEach((ghost) => ghost.couple(tool));
  }

  /** Move all links to the configuration q [rad or m]. */
  place(q) {
    this.q = Array.from(q);
    this.kinematics.place(this.q).forEach((T, joint) => {
      const group = this._groups[joint + 1];
      group.matrix.fromArray(T);
      group.matrixWorldNeedsUpdate = true;
    });
  }

  /** The group that joint `index` carries; -1 is the base. */
  group(index) {
    return this._groups[index + 1];
  }

  /** Show only what joints carry that stand elsewhere than in `other` by more than `apart` [m, and as much in axes]. */
  showApart(other, apart) {
    this._groups.forEach((group, index) => {
      const [ours, theirs] = [group.matrix.elements, other._groups[index].matrix.elements];
      group.visible = ours.some((value, k) => Math.abs(value - theirs[k]) > apart);
    });
  }

  /** T_world_tool of a hand, or of the present tool, as 16 numbers. */
  toolPose(index = 0) {
    const tool = this.robot.exchangeable?.[this.coupled] ?? this.robot.tools[index];
    return tool ? this.kinematics.carried(tool.joint, tool.T_joint_tool) : null;
  }

  /** T_world_camera, as 16 numbers, or null. */
  cameraPose() {
    const camera = this.robot.camera;
    return camera ? this.kinematics.carried(camera.joint, camera.T_joint_camera) : null;
  }

  /** Another view of the same robot, of another material without base and shadows; it shares the geometry. */
  ghost(material) {
    const ghost = new RobotView(this.robot);
    this._groups.forEach((group, index) => {
      if (index === 0) return; // the base, which stays where it is
      for (const { geometry, userData, visible } of group.children.filter((child) => child.userData.isLink)) {
        const mesh = new THREE.Mesh(geometry, material);
        mesh.userData.tool = userData.tool;
        mesh.visible = visible;
        ghost._groups[index].add(mesh);
      }
    });
    ghost.coupled = this.coupled;
    this._ghosts.push(ghost);
    return ghost;
  }

  /** All links that one joint carries are one mesh, those of a tool another; bodies are remembered by name. */
  async _addLinks(links, store, material) {
    const { joint, tool } = links[0];
    const meshes = links.flatMap((link) => link.meshes.map((mesh) => ({ ...mesh, body: link.name })));
    const parts = await Promise.all(
      meshes.map(async (mesh) => ({
        geometry: await store.geometry(mesh),
        matrix: mesh.T_link_mesh,
        colour: colourOf(mesh.rgba),
        body: mesh.body,
      })),
    );
    if (!parts.length) return;
    const mesh = new THREE.Mesh(merge(parts), material);
    mesh.castShadow = mesh.receiveShadow = true;
    Object.assign(mesh.userData, { isLink: true, tool });
    this.group(joint).add(mesh);
    for (const part of parts) {
      const known = this.bodies.get(part.body) ?? { group: this.group(joint), parts: [] };
      known.parts.push(part);
      this.bodies.set(part.body, known);
    }
  }
}

/** What stands in the cell: one merged mesh, its edges, and its bodies by name. */
export class StructureView {
  static async make(structure, store, material) {
    const view = new StructureView();
    const parts = await Promise.all(
      structure.map(async (body) => ({
        geometry: await store.geometry(body),
        matrix: body.T_world,
        colour: colourOf(body.rgba),
        name: body.name,
      })),
    );
    for (const part of parts) view.bodies.set(part.name, { group: view.root, parts: [part] });
    if (!parts.length) return view;
    const mesh = new THREE.Mesh(merge(parts), material);
    mesh.castShadow = mesh.receiveShadow = true;
    view.root.add(mesh);
    return view;
  }

  constructor() {
    this.root = new THREE.Group();
    this.root.name = "structure";
    this.bodies = new Map();
  }
}

/** A mesh that lies over one body, to mark it; null where the body has no picture. */
export function bodyShell(body, material) {
  if (!body) return null;
  const white = new THREE.Color(1, 1, 1);
  const mesh = new THREE.Mesh(
    merge(body.parts.map(({ geometry, matrix }) => ({ geometry, matrix: matrix ?? IDENTITY, colour: white }))),
    material,
  );
  mesh.renderOrder = 2;
  return mesh;
}

// From frames, 25 a second, to pictures: robots glide from where they are shown to where the newest frame has them.

const GLIDE_MS = 45; // a frame's time and a little more
const SAME = 1e-6; // rad or m

export class Motion {
  /** @param views RobotView of each robot, in the order of the frames; stage Stage. */
  constructor(live, views, stage) {
    Object.assign(this, { views, stage, live });
    this._from = this._to = null;
    live.addEventListener("shown", ({ detail }) => this._take(detail));
    stage.beforeEach((now) => this._glide(now));
  }

  _take(frame) {
    this.views.forEach((view, index) => view.couple(frame.robots[index].coupled ?? this.live.robot(view.name)?.coupled ?? null));
    this._from = this._to ? this.views.map((view) => view.q) : frame.robots.map(({ q }) => Array.from(q));
    this._to = frame.robots.map(({ q }) => Array.from(q));
    this._since = performance.now();
    this._isMoving = this._to.some((q, index) => q.some((value, k) => Math.abs(value - this.views[index].q[k]) > SAME));
  }

  _glide(now) {
    if (!this._isMoving) return;
    const share = Math.min(1, Math.max(0, (now - this._since) / GLIDE_MS));
    this.views.forEach((view, index) => {
      const [from, to] = [this._from[index], this._to[index]];
      view.place(to.map((value, k) => from[k] + share * (value - from[k])));
    });
    this._isMoving = share < 1;
    this.stage.ask(true);
  }
}
