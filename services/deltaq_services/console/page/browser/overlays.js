// What explains the picture: the nearest bodies, the coming brake, what bound the last verdict, and what the camera sees.

import { THREE } from "nicegui-scene";
import { el, part, say } from "./dom.js";
import { bodyShell } from "./robots.js";

// blue, yellow and red-violet are told apart by every kind of colour vision, and none is the robots' orange
const MARGINS = [[0.1, "#ff3d6e"], [0.3, "#f0d53a"], [Infinity, "#4fb3ea"]];
const WITHIN_ROBOT = 0.4; // of one robot's own bodies a smaller distance is kept, and is usual
const BRAKE = "#39c6d6";
const MOVES = 0.015; // rad or m to rest, from which on the brake is drawn
const SEEN = 0.004; // m: a link whose brake is shorter hides its own ghost
const MARKED_MS = 1500;
const GHOSTS = { full: [0.34, 0.67, 1], lean: [1] }; // shares of the way to rest at which a robot is drawn

export class Overlays {
  /** @param views RobotView of each robot; structure StructureView; picture FollowerPicture or null. */
  constructor(stage, live, scene, views, structure, picture) {
    Object.assign(this, { stage, live, scene, views, picture });
    this.bodies = new Map([...structure.bodies, ...views.flatMap((view) => [...view.bodies])]);
    this._shells = new Map();
    this._nearest();
    this._brakes();
    if (picture) this._sight();
    live.addEventListener("shown", ({ detail }) => this._take(detail));
    stage.beforeEach(() => this._follow());
    stage.afterEach(() => this._label());
  }

  _nearest() {
    this._material = new THREE.MeshBasicMaterial({ toneMapped: false, fog: false });
    const rod = new THREE.CylinderGeometry(1, 1, 1, 10).rotateX(Math.PI / 2);
    this._rod = new THREE.Mesh(rod, this._material);
    this._ends = [0, 1].map(() => new THREE.Mesh(new THREE.SphereGeometry(0.018, 14, 10), this._material));
    this._pair = new THREE.Group().add(this._rod, ...this._ends);
    this._pair.visible = false;
    this.stage.marks.add(this._pair);
    this._tag = part("nearest");
    this._tagTexts = [el("b"), el("span")];
    this._tag.append(...this._tagTexts);
  }

  _brakes() {
    const material = new THREE.MeshBasicMaterial({
      color: BRAKE, transparent: true, opacity: 0.2, depthWrite: false,
      polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 4, // behind what does not move
    });
    this._ghosts = this.views.map((view) =>
      GHOSTS[this.stage.full ? "full" : "lean"].map((share) => {
        const ghost = view.ghost(material);
        ghost.root.visible = false;
        this.stage.marks.add(ghost.root);
        return { share, ghost };
      }),
    );
  }

  _sight() {
    const material = new THREE.LineBasicMaterial({ color: "#59d3e6", transparent: true, opacity: 0.75 });
    this._frustum = new THREE.LineSegments(new THREE.BufferGeometry(), material);
    const far = 0.45;
    const high = far * Math.tan(this.picture.settings.fov_rad / 2);
    const wide = 1.5 * high;
    const corners = [[high, wide], [high, -wide], [-high, -wide], [-high, wide]].map(([x, y]) => [x, y, far]);
    const lines = corners.flatMap((corner, k) => [[0, 0, 0], corner, corner, corners[(k + 1) % 4]]);
    this._frustum.geometry.setAttribute("position", new THREE.Float32BufferAttribute(lines.flat(), 3));
    this._frustum.matrixAutoUpdate = false;
    this._line = new THREE.Line(new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3()]),
      new THREE.LineDashedMaterial({ color: "#59d3e6", dashSize: 0.04, gapSize: 0.03 }));
    this._line.frustumCulled = false;
    this.stage.marks.add(this._frustum, this._line);
  }

  _take(frame) {
    this._frame = frame;
    frame.robots.forEach((robot, index) => {
      const moves = robot.q.some((value, k) => Math.abs(robot.rest[k] - value) > MOVES);
      for (const { share, ghost } of this._ghosts[index]) {
        if (moves) {
          ghost.place(robot.q.map((value, k) => value + share * (robot.rest[k] - value)));
          ghost.showApart(this.views[index], SEEN);
        }
        if (moves || ghost.root.visible) this.stage.ask();
        ghost.root.visible = moves;
      }
    });
    const { nearest } = frame;
    this._pair.visible = !!nearest;
    if (nearest) {
      const [a, b] = nearest.points.map((point) => new THREE.Vector3(...point));
      const [from, to] = [this.scene.bodies[nearest.a], this.scene.bodies[nearest.b]];
      const share = from.split("/")[0] === to.split("/")[0] ? WITHIN_ROBOT : 1;
      const [, colour] = MARGINS.find(([bound]) => nearest.distance < share * bound);
      const thick = nearest.distance < share * MARGINS[0][0] ? 0.011 : 0.006;
      this._material.color.set(colour);
      this._tag.style.setProperty("--margin", colour);
      this._rod.position.lerpVectors(a, b, 0.5);
      this._rod.scale.set(thick, thick, Math.max(1e-4, a.distanceTo(b)));
      this._rod.lookAt(b);
      this._ends[0].position.copy(a);
      this._ends[1].position.copy(b);
      say(this._tagTexts[0], `${(100 * nearest.distance).toFixed(nearest.distance < 0.2 ? 1 : 0)} cm`);
      say(this._tagTexts[1], `${from} – ${to}`);
    }
    this._mark(frame);
  }

  /** Mark the bodies, or the joint's link, that bound the newest verdicts, and say what bound them. */
  _mark(frame) {
    const now = performance.now();
    const words = [];
    this.scene.robots.forEach((robot, index) => {
      const bound = this.live.bound(robot.name);
      if (["scaled", "held", "refused"].includes(frame.robots[index].outcome)) this._boundAt = { ...this._boundAt, [robot.name]: now };
      if (!bound || !(now - (this._boundAt?.[robot.name] ?? -Infinity) < MARKED_MS)) return;
      words.push(`${robot.name} ${bound.text}`);
      const joint = robot.joints.findIndex(({ name }) => name === bound.joint);
      const names = joint < 0 ? bound.bodies : robot.links.filter((link) => link.joint === joint).map(({ name }) => name);
      for (const name of names) this._shell(name).until = now + MARKED_MS;
    });
    for (const shell of this._shells.values()) {
      const isOn = shell.until > now;
      if (shell.mesh && shell.mesh.visible !== isOn) {
        shell.mesh.visible = isOn;
        this.stage.ask();
      }
    }
    say(part("notices"), words.join("   "));
  }

  _shell(name) {
    if (!this._shells.has(name)) {
      this._shellPaint ??= new THREE.MeshBasicMaterial({
        color: "#ff3d6e", transparent: true, opacity: 0.5, polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -2,
      });
      const body = this.bodies.get(name);
      const mesh = bodyShell(body, this._shellPaint);
      if (mesh) body.group.add(mesh);
      this._shells.set(name, { mesh, until: 0 });
    }
    return this._shells.get(name);
  }

  _follow() {
    const focus = this.picture?.focus();
    if (!this.picture) return;
    const T = this.picture.view.cameraPose();
    this._frustum.matrix.fromArray(T);
    this._frustum.matrixWorldNeedsUpdate = true;
    this._line.visible = !!focus;
    if (!focus) return;
    const places = this._line.geometry.attributes.position;
    places.setXYZ(0, T[12], T[13], T[14]);
    places.setXYZ(1, ...focus);
    places.needsUpdate = true;
    this._line.computeLineDistances();
  }

  /** Put the distance beside the middle of the nearest pair. */
  _label() {
    const isShown = this._pair.visible && !this.picture?.isLarge;
    this._tag.hidden = !isShown;
    if (!isShown) return;
    const at = this._rod.position.clone().project(this.stage.camera);
    const { clientWidth, clientHeight } = this.stage.holder;
    const [x, y] = [(0.5 + at.x / 2) * clientWidth, (0.5 - at.y / 2) * clientHeight];
    const isInside = at.z < 1 && x > 0 && x < clientWidth && y > 0 && y < clientHeight;
    this._tag.style.transform = isInside ? `translate(${Math.min(x + 14, clientWidth - 210)}px, ${y - 12}px)` : "translate(-999px, 0)";
  }
}
