// The gizmo: arrows and rings at a pose, which the pointer drags along and about the axes of the world or of the hand.

import { THREE } from "./vendor/three.js";
import { COLOURS } from "./axes.js";
import { aboutAxis, alongAxis, turned } from "./drag_math.js";

const SIZE = 0.075; // of an arrow, as a share of its distance from the eye
const GRIP = 3.2; // how much thicker than it looks a handle is taken hold of

export class Gizmo extends EventTarget {
  /** Events: "drag" and "dragend", after which `T`, the pose of 16 numbers, has changed. */
  constructor(stage) {
    super();
    Object.assign(this, { stage, T: null, byHand: false, _held: null });
    this.root = new THREE.Group();
    this.root.visible = false;
    this._handles = [0, 1, 2].flatMap((axis) => [this._arrow(axis), this._ring(axis)]);
    for (const { shown, grip } of this._handles) this.root.add(shown, grip);
    stage.marks.add(this.root);
    stage.beforeEach(() => this._fit());
    const { canvas } = stage;
    // ahead of the orbit's own listener, which then lets the pointer go
    canvas.addEventListener("pointerdown", (event) => this._take(event), { capture: true });
    canvas.addEventListener("pointermove", (event) => this._move(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(kind, () => this._drop());
  }

  get isHeld() {
    return this._held !== null;
  }

  /** Show it at the pose T; byHand: along the hand's axes, else the world's. */
  place(T, byHand) {
    if (this.isHeld) return;
    this.T = Float64Array.from(T);
    this.byHand = byHand;
    this.root.visible = true;
    this._fit(); // for a pointer that is quicker than the next picture
    this.stage.ask();
  }

  hide() {
    if (!this.root.visible) return;
    this._drop();
    this.root.visible = false;
    this.stage.ask();
  }

  _axis(index) {
    if (!this.byHand) return [0, 1, 2].map((k) => (k === index ? 1 : 0));
    return [0, 1, 2].map((k) => this.T[4 * index + k]);
  }

  _handle(axis, kind, shapes, grip) {
    const paint = new THREE.MeshBasicMaterial({
      color: COLOURS[axis], toneMapped: false, fog: false, depthTest: false, transparent: true, opacity: 0.9,
    });
    const shown = new THREE.Group();
    shown.add(...shapes.map((shape) => new THREE.Mesh(shape, paint)));
    for (const mesh of shown.children) mesh.renderOrder = 10;
    const felt = new THREE.Mesh(grip, paint);
    felt.visible = false; // raycast, never drawn
    felt.userData = { axis, kind, paint };
    for (const part of [shown, felt]) part.rotation.set(...[[0, 0, -Math.PI / 2], [0, 0, 0], [Math.PI / 2, 0, 0]][axis]);
    return { shown, grip: felt };
  }

  _arrow(axis) {
    const shaft = new THREE.CylinderGeometry(0.018, 0.018, 0.8, 8).translate(0, 0.52, 0);
    const head = new THREE.ConeGeometry(0.07, 0.22, 14).translate(0, 1, 0);
    return this._handle(axis, "move", [shaft, head], new THREE.CylinderGeometry(0.1, 0.1, 0.95, 6).translate(0, 0.65, 0));
  }

  _ring(axis) {
    const ring = new THREE.TorusGeometry(0.62, 0.014, 6, 48).rotateX(Math.PI / 2);
    return this._handle(axis, "turn", [ring], new THREE.TorusGeometry(0.62, 0.014 * GRIP, 6, 32).rotateX(Math.PI / 2));
  }

  /** Keep its size on the screen, and its axes where they are. */
  _fit() {
    if (!this.root.visible) return;
    const { T } = this;
    const size = SIZE * this.stage.camera.position.distanceTo(new THREE.Vector3(T[12], T[13], T[14]));
    const [x, y, z] = [0, 1, 2].map((index) => this._axis(index));
    const pose = new THREE.Matrix4().set(x[0], y[0], z[0], T[12], x[1], y[1], z[1], T[13], x[2], y[2], z[2], T[14], 0, 0, 0, 1);
    pose.decompose(this.root.position, this.root.quaternion, this.root.scale);
    this.root.scale.setScalar(size);
  }

  _ray(event) {
    const box = this.stage.canvas.getBoundingClientRect();
    const at = new THREE.Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    const caster = new THREE.Raycaster();
    caster.setFromCamera(at, this.stage.camera);
    return caster;
  }

  _lines(event) {
    const { ray } = this._ray(event);
    return { origin: ray.origin.toArray(), direction: ray.direction.toArray() };
  }

  /** How far the pointer is along or about the axis that is held [m or rad]; null where it tells nothing. */
  _reach(event) {
    const { kind, axis, T, zero } = this._held;
    const origin = [T[12], T[13], T[14]];
    return kind === "move" ? alongAxis(this._lines(event), origin, axis) : aboutAxis(this._lines(event), origin, axis, zero);
  }

  _take(event) {
    if (!this.root.visible || event.button !== 0) return;
    this.root.updateMatrixWorld(true);
    const grips = this._handles.map(({ grip }) => grip);
    for (const grip of grips) grip.visible = true;
    const [hit] = this._ray(event).intersectObjects(grips, false);
    for (const grip of grips) grip.visible = false;
    if (!hit) return;
    event.stopImmediatePropagation(); // the orbit stays where it is
    const { axis, kind, paint } = hit.object.userData;
    this._held = { kind, axis: this._axis(axis), zero: this._axis((axis + 1) % 3), T: Float64Array.from(this.T), paint };
    this._held.from = this._reach(event);
    if (this._held.from === null) {
      this._held = null;
      return;
    }
    paint.color.set("#ffffff");
    this.stage.canvas.setPointerCapture(event.pointerId);
    this.stage.ask();
  }

  _move(event) {
    if (!this._held) return;
    const now = this._reach(event);
    if (now === null) return;
    const { kind, axis, T, from } = this._held;
    const change = now - from;
    this.T = kind === "move" ? T.map((value, k) => (k > 11 && k < 15 ? value + change * axis[k - 12] : value)) : turned(T, axis, change);
    this.stage.ask();
    this.dispatchEvent(new Event("drag"));
  }

  _drop() {
    if (!this._held) return;
    const { paint } = this._held;
    this._held = null;
    paint.color.set(COLOURS[this._handles.findIndex(({ grip }) => grip.userData.paint === paint) >> 1]);
    this.stage.ask();
    this.dispatchEvent(new Event("dragend"));
  }
}
