// What explains the picture: the nearest bodies, the coming brake, what bound the last verdict, and what the camera sees.

import { THREE } from "./vendor/three.js";
import { el, part, say } from "./dom.js";
import { bodyShell } from "./robots.js";

// blue, yellow and red-violet are told apart by every kind of colour vision, and none is the robots' orange
const MARGINS = [[0.1, "#ff3d6e"], [0.3, "#f0d53a"], [Infinity, "#4fb3ea"]];
const WITHIN_ROBOT = 0.4; // of one robot's own bodies a smaller distance is kept, and is usual
const BRAKE = "#39c6d6";
const SIGHT = { dark: "#59d3e6", light: "#00667e" };
const MOVES = 0.015; // rad or m to rest, from which on the brake is drawn
const SEEN = 0.004; // m: a link whose brake is shorter hides its own ghost
const FRUSTUM_M = 0.45; // how far the pyramid of the view reaches
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
    this._tag = new Tag(this.stage, "nearest");
    this._boundTags = this.views.map(() => new Tag(this.stage, "nearest bound"));
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
    const corners = [[1, 1.5], [1, -1.5], [-1, -1.5], [-1, 1.5]].map(([x, y]) => [x, y, 1]);
    const around = corners.map((corner, k) => [corner, corners[(k + 1) % 4]]);
    this._sightPaint = {
      lines: new THREE.LineBasicMaterial({ toneMapped: false }),
      sides: new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.1, side: THREE.DoubleSide, depthWrite: false, toneMapped: false }),
      dashes: new THREE.LineDashedMaterial({ dashSize: 0.04, gapSize: 0.03, toneMapped: false }),
      mark: new THREE.SpriteMaterial({ map: ringTexture(), sizeAttenuation: false, depthTest: false, transparent: true, toneMapped: false }),
    };
    const { lines, sides, dashes, mark } = this._sightPaint;
    const edges = new THREE.LineSegments(geometryOf(around.flatMap(([one, other]) => [[0, 0, 0], one, one, other])), lines);
    const faces = new THREE.Mesh(geometryOf(around.flatMap(([one, other]) => [[0, 0, 0], one, other])), sides);
    this._frustum = new THREE.Group().add(edges, faces);
    this._frustum.matrixAutoUpdate = false;
    this._line = new THREE.Line(geometryOf([[0, 0, 0], [0, 0, 0]]), dashes);
    this._line.frustumCulled = false;
    this._focusMark = new THREE.Sprite(mark);
    this._focusMark.scale.setScalar(0.032);
    this._focusMark.renderOrder = 3;
    this.stage.marks.add(this._frustum, this._line, this._focusMark);
  }

  /** Light or dark room. */
  enter(dark) {
    for (const paint of Object.values(this._sightPaint ?? {})) paint.color.set(dark ? SIGHT.dark : SIGHT.light);
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
      this._tag.box.style.setProperty("--margin", colour);
      this._rod.position.lerpVectors(a, b, 0.5);
      this._rod.scale.set(thick, thick, Math.max(1e-4, a.distanceTo(b)));
      this._rod.lookAt(b);
      this._ends[0].position.copy(a);
      this._ends[1].position.copy(b);
      this._tag.say(`${(100 * nearest.distance).toFixed(nearest.distance < 0.2 ? 1 : 0)} cm`, `${from} – ${to}`);
    }
    this._mark(frame);
  }

  /** Mark the bodies, or the joint's link, that bound the newest verdicts, and say beside them what bound them. */
  _mark(frame) {
    const now = performance.now();
    const words = [];
    this._bounds = this.scene.robots.map((robot, index) => {
      const bound = this.live.bound(robot.name);
      if (["scaled", "held", "refused"].includes(frame.robots[index].outcome)) this._boundAt = { ...this._boundAt, [robot.name]: now };
      if (!bound || !(now - (this._boundAt?.[robot.name] ?? -Infinity) < MARKED_MS)) return null;
      words.push(`${robot.name} ${bound.text}`);
      const joint = robot.joints.findIndex(({ name }) => name === bound.joint);
      const names = joint < 0 ? bound.bodies : robot.links.filter((link) => link.joint === joint).map(({ name }) => name);
      const shells = names.map((name) => this._shell(name));
      for (const shell of shells) shell.until = now + MARKED_MS;
      this._boundTags[index].say(robot.name, bound.text);
      return shells.find(({ mesh }) => mesh)?.mesh ?? null;
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
    const high = FRUSTUM_M * Math.tan(this.picture.settings.fov_rad / 2);
    this._frustum.matrix.fromArray(T).scale(new THREE.Vector3(high, high, FRUSTUM_M));
    this._frustum.matrixWorldNeedsUpdate = true;
    this._line.visible = this._focusMark.visible = !!focus;
    if (!focus) return;
    this._focusMark.position.set(...focus);
    const places = this._line.geometry.attributes.position;
    places.setXYZ(0, T[12], T[13], T[14]);
    places.setXYZ(1, ...focus);
    places.needsUpdate = true;
    this._line.computeLineDistances();
  }

  /** Put words beside what they are about, where they hide no hand, no camera and no other words. */
  _label() {
    const isLarge = this.picture?.isLarge;
    const hands = this.views.flatMap((view) => view.robot.tools.map((_, index) => view.toolPose(index)));
    const kept = [...hands, this.picture?.view.cameraPose()].filter(Boolean).map((T) => new THREE.Vector3(T[12], T[13], T[14]));
    this._tag.place(this._pair.visible && !isLarge ? this._rod.position : null, kept);
    let isBeside = false;
    this._boundTags.forEach((tag, index) => {
      const mesh = isLarge ? null : this._bounds?.[index];
      mesh?.geometry.boundingSphere ?? mesh?.geometry.computeBoundingSphere();
      isBeside = tag.place(mesh ? mesh.localToWorld(mesh.geometry.boundingSphere.center.clone()) : null, kept) || isBeside;
    });
    part("notices").dataset.beside = String(isBeside); // then they are there for who hears the page
  }
}

function geometryOf(points) {
  return new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute(points.flat(), 3));
}

/** A ring with a dot in it, white, to be coloured. */
function ringTexture() {
  const canvas = Object.assign(document.createElement("canvas"), { width: 64, height: 64 });
  const pen = canvas.getContext("2d");
  Object.assign(pen, { strokeStyle: "#fff", fillStyle: "#fff", lineWidth: 6 });
  pen.beginPath();
  pen.arc(32, 32, 26, 0, 2 * Math.PI);
  pen.stroke();
  pen.beginPath();
  pen.arc(32, 32, 6, 0, 2 * Math.PI);
  pen.fill();
  return new THREE.CanvasTexture(canvas);
}

// Words over the picture, beside the place in the cell that they are about.

const AWAY = 26; // px from the place to the words
const BETTER = 24; // px: words change their side only for so much more room
const SIDES = [[1, 0], [-1, 0], [1, -1], [-1, -1], [1, 1], [-1, 1]];

/** How far the nearest of some points is from a box [px]. */
export function roomOf([left, top, width, height], points) {
  return points.reduce((least, [x, y]) => {
    const [aside, above] = [Math.max(left - x, 0, x - left - width), Math.max(top - y, 0, y - top - height)];
    return Math.min(least, Math.hypot(aside, above));
  }, Infinity);
}

/** Left and top of words of that size beside (x, y), on each side, kept within the width and height of the picture. */
export function boxesBeside([x, y], [width, height], [wide, high]) {
  return SIDES.map(([aside, above]) => {
    const left = aside > 0 ? x + AWAY : x - AWAY - width;
    const top = y - height / 2 + above * (height + AWAY);
    return [Math.min(Math.max(6, left), wide - width - 6), Math.min(Math.max(6, top), high - height - 6), width, height];
  });
}

export class Tag {
  /** @param kind class of its element. */
  constructor(stage, kind) {
    this.stage = stage;
    this.box = el("div", { class: kind, hidden: true });
    this._texts = [el("b"), el("span")];
    this._side = 0;
    this.box.append(...this._texts);
    part("stage").append(this.box);
  }

  say(title, text) {
    say(this._texts[0], title);
    say(this._texts[1], text);
  }

  /** Stand beside `at` (Vector3 in the world, null for nowhere), away from `kept`; returns whether it is seen. */
  place(at, kept) {
    const { clientWidth: wide, clientHeight: high } = this.stage.holder;
    const onScreen = (point) => {
      const seen = point.clone().project(this.stage.camera);
      return seen.z < 1 ? [(0.5 + seen.x / 2) * wide, (0.5 - seen.y / 2) * high] : null;
    };
    const place = at && onScreen(at);
    const isSeen = !!place && place[0] > 0 && place[0] < wide && place[1] > 0 && place[1] < high;
    this.box.hidden = !isSeen;
    if (!isSeen) return false;
    const points = [...kept.map(onScreen).filter(Boolean), place];
    const boxes = boxesBeside(place, [this.box.offsetWidth, this.box.offsetHeight], [wide, high]);
    const rooms = boxes.map((box) => Math.min(120, roomOf(box, points)));
    const best = rooms.indexOf(Math.max(...rooms));
    if (rooms[best] > rooms[this._side] + BETTER) this._side = best;
    this.box.style.transform = `translate(${boxes[this._side][0]}px, ${boxes[this._side][1]}px)`;
    return true;
  }
}
