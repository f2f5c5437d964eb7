// Ways that a robot is offered, and their picture: where they lead as a ghost, and how the hand and the arm get there.

import { THREE } from "./vendor/three.js";
import { Kinematics } from "./kinematics.js";

const CLEAR = "#8fd0ff";
const BLOCKED = "#ff3d6e";
const RUN_MS = 1500; // a ghost runs along its way once, and then stands at its end
const POINT_MS = 45; // a long way takes longer
const MOVES_M = 0.02;
const HALF_LINE_M = 0.007;

/** The ways that each robot's driver offers, as they were told last. */
export class Ways extends EventTarget {
  constructor(live) {
    super();
    this.live = live;
    this._told = new Map();
    this.planned = null; // the whole of a routine
    live.connection.addEventListener("ways", ({ detail }) => {
      if (detail.routine) this.planned = detail;
      else this._told.set(detail.robot, detail);
      this.dispatchEvent(new Event("change"));
    });
  }

  /** Those of a robot in a mode; none if it is driven in another. */
  of(robot, mode) {
    const told = this._told.get(robot);
    return told?.mode === mode && this.live.robot(robot)?.mode === mode ? told.ways : [];
  }
}

/** The configuration at a share of a way's points, 0 to 1. */
export function along(points, share) {
  const at = Math.min(1, Math.max(0, share)) * (points.length - 1);
  const [before, after] = [points[Math.floor(at)], points[Math.ceil(at)]];
  return before.map((value, k) => value + (at - Math.floor(at)) * (after[k] - value));
}

/** Ghosts and lines of one way at a time. */
export class WayPicture {
  constructor(stage, views) {
    Object.assign(this, { stage, views, _shown: null, _ghosts: new Map() });
    this._paints = Object.fromEntries(
      [["clear", CLEAR, 0.42], ["blocked", BLOCKED, 0.5]].map(([name, color, opacity]) => [
        name, new THREE.MeshBasicMaterial({ color, transparent: true, opacity, depthWrite: false, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 2 }),
      ]),
    );
    this._lines = new THREE.Group();
    stage.marks.add(this._lines);
    stage.beforeEach((now) => this._run(now));
  }

  get way() {
    return this._shown?.way ?? null;
  }

  /** Show a way of the robot of that name, or with null none. */
  show(name, way, runs = true) {
    if (way === this.way) return;
    this._clear();
    this.stage.ask();
    this._shown = null;
    if (!way) return;
    const view = this.views.find((one) => one.name === name);
    const points = way.points.length > 1 ? way.points : [way.q, way.q];
    const [end, blocked] = this._ghostsOf(view);
    end.place(runs ? points[0] : way.q);
    end.root.visible = true;
    if (way.clear < 1) {
      blocked.place(along(points, way.clear));
      blocked.root.visible = true;
    }
    this._shown = { way, points, end, blocked, since: performance.now(), runs: runs && way.points.length > 1 };
    this._draw(view, points, way.clear);
  }

  _ghostsOf(view) {
    if (!this._ghosts.has(view)) {
      const ghosts = [this._paints.clear, this._paints.blocked].map((paint) => view.ghost(paint));
      for (const { root } of ghosts) {
        root.visible = false;
        this.stage.marks.add(root);
      }
      this._ghosts.set(view, ghosts);
    }
    return this._ghosts.get(view);
  }

  _clear() {
    for (const ghosts of this._ghosts.values()) for (const { root } of ghosts) root.visible = false;
    for (const line of this._lines.children) {
      line.geometry.dispose();
      line.material.dispose();
    }
    this._lines.clear();
  }

  /** Lines of the hands, and of the joint that gets about most where the hands stay. */
  _draw(view, points, clear) {
    const kinematics = new Kinematics(view.robot);
    const tracks = new Map();
    const add = (name, T) => tracks.set(name, [...(tracks.get(name) ?? []), new THREE.Vector3(T[12], T[13], T[14])]);
    for (const q of points) {
      kinematics.place(q).forEach((T, joint) => add(joint, T));
      for (const tool of view.robot.tools) add(tool.name, kinematics.carried(tool.joint, tool.T_joint_tool));
    }
    const extent = (track) => new THREE.Box3().setFromPoints(track).getSize(new THREE.Vector3()).length();
    const hands = view.robot.tools.map(({ name }) => tracks.get(name)).filter((track) => extent(track) > MOVES_M);
    const joints = view.robot.joints.map((_, joint) => tracks.get(joint)).sort((a, b) => extent(b) - extent(a));
    for (const track of [...hands, ...(hands.length ? [] : joints.slice(0, 1).filter((one) => extent(one) > MOVES_M))]) {
      const until = Math.max(1, Math.round(clear * (track.length - 1)));
      this._line(track.slice(0, until + 1), CLEAR);
      if (clear < 1) this._line(track.slice(until), BLOCKED);
    }
  }

  _line(track, color) {
    if (track.length < 2) return;
    const curve = new THREE.CatmullRomCurve3(track);
    const tube = new THREE.TubeGeometry(curve, 3 * track.length, HALF_LINE_M, 6);
    this._lines.add(new THREE.Mesh(tube, new THREE.MeshBasicMaterial({ color, toneMapped: false, fog: false })));
  }

  _run(now) {
    if (!this._shown?.runs) return;
    const share = (now - this._shown.since) / Math.max(RUN_MS, POINT_MS * this._shown.points.length);
    this._shown.end.place(along(this._shown.points, share));
    this._shown.runs = share < 1;
    this.stage.ask();
  }
}
