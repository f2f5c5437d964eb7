// The follower's picture: a second camera in the same scene, with a reticle, as an inset or large, plain or in stereo.

import { THREE } from "nicegui-scene";
import { degrees, el, part, remember, remembered, say } from "./dom.js";

const SHAPES = ["plain", "side by side", "red-cyan"];
const FAR_M = 40;

/** Angle between view axis and focus [rad], and distance [m], of the camera pose T (16 numbers). */
export function viewError(T, focus) {
  const line = [0, 1, 2].map((k) => focus[k] - T[12 + k]);
  const distance = Math.hypot(...line);
  const along = (line[0] * T[8] + line[1] * T[9] + line[2] * T[10]) / distance;
  return { angle: Math.acos(Math.min(1, Math.max(-1, along))), distance };
}

export class FollowerPicture {
  /** @param view RobotView that carries the camera; others the other robots' views. */
  constructor(stage, live, view, others) {
    Object.assign(this, { stage, live, view, others, isLarge: false });
    this.settings = view.robot.camera;
    this.shape = remembered("stereo", SHAPES[0]);
    if (!this.settings.baseline_m) this.shape = SHAPES[0];
    this.camera = new THREE.PerspectiveCamera(degrees(this.settings.fov_rad), 1.5, 0.05, FAR_M);
    this.camera.matrixAutoUpdate = false;
    this._build();
    stage.afterEach((renderer) => this._draw(renderer));
  }

  /** What the camera is to look at: as the server says, else the hand of another robot. */
  focus() {
    if (this.live.shown?.focus) return this.live.shown.focus;
    const pose = this.others[0]?.toolPose();
    return pose ? [pose[12], pose[13], pose[14]] : null;
  }

  error() {
    const focus = this.focus();
    return focus ? viewError(this.view.cameraPose(), focus) : null;
  }

  toggle() {
    this.isLarge = !this.isLarge;
    this.box.dataset.large = String(this.isLarge);
    this.stage.ask();
  }

  _build() {
    this.box = part("follower");
    this._text = el("output");
    this._ring = el("circle", { r: 7, class: "ring" });
    this._line = el("line", { class: "miss" });
    this._reticle = el("svg", { class: "reticle", "aria-hidden": "true" },
      el("path", { d: "M-46 0h34M12 0h34M0 -46v34M0 12v34", class: "cross" }), el("circle", { r: 30, class: "cross faint" }), this._line, this._ring);
    const shapes = el("select", { "aria-label": "Stereo" }, ...SHAPES.map((shape) => el("option", { selected: shape === this.shape }, shape)));
    shapes.hidden = !this.settings.baseline_m;
    shapes.addEventListener("change", () => {
      this.shape = shapes.value;
      remember("stereo", this.shape);
      this.stage.ask();
    });
    this.box.append(
      el("figcaption", {}, el("b", {}, `${this.view.name} camera`), this._text, shapes,
        el("button", { class: "plain", title: "Large or small (V)", "aria-label": "Large or small", onclick: () => this.toggle() }, "⤢")),
      this._reticle,
    );
  }

  /** Place the camera: three.js looks along -z with y up, ours along z with x up. */
  _place(T, aside = 0) {
    const m = this.camera.matrix;
    m.set(T[4], T[0], -T[8], T[12], T[5], T[1], -T[9], T[13], T[6], T[2], -T[10], T[14], 0, 0, 0, 1);
    m.elements[12] += aside * T[4];
    m.elements[13] += aside * T[5];
    m.elements[14] += aside * T[6];
    this.camera.matrixWorldNeedsUpdate = true;
    this.camera.updateMatrixWorld(true);
  }

  _draw(renderer) {
    const [holder, box] = [this.stage.canvas.getBoundingClientRect(), this.box.getBoundingClientRect()];
    if (!box.width || !box.height) return;
    const left = box.left - holder.left;
    const bottom = holder.bottom - box.bottom;
    const { scene, marks } = this.stage;
    const T = this.view.cameraPose();
    marks.visible = false;
    renderer.setScissorTest(true);
    const eyes = this.shape === SHAPES[0] ? [null] : [-1, 1];
    const split = this.shape === SHAPES[1];
    eyes.forEach((eye, index) => {
      const width = split ? box.width / 2 : box.width;
      const x = left + (split ? index * width : 0);
      renderer.setViewport(x, bottom, width, box.height);
      renderer.setScissor(x, bottom, width, box.height);
      this.camera.aspect = width / box.height;
      this.camera.updateProjectionMatrix();
      this._place(T, eye ? (eye * this.settings.baseline_m) / 2 : 0);
      if (this.shape === SHAPES[2]) {
        // left eye into red, right eye into green and blue
        renderer.getContext().colorMask(eye < 0, eye > 0, eye > 0, true);
        renderer.state.buffers.color.setLocked(true);
      }
      renderer.render(scene, this.camera);
      renderer.state.buffers.color.setLocked(false);
      renderer.getContext().colorMask(true, true, true, true);
    });
    renderer.setScissorTest(false);
    const size = renderer.getSize(new THREE.Vector2());
    renderer.setViewport(0, 0, size.x, size.y);
    marks.visible = true;
    this._place(T);
    this._aim(box);
  }

  /** Put the ring where the focus is in the picture, and say how far off it is. */
  _aim({ width, height }) {
    const focus = this.focus();
    this._reticle.setAttribute("viewBox", `${-width / 2} ${-height / 2} ${width} ${height}`);
    const error = this.error();
    this._ring.style.display = this._line.style.display = "none";
    if (!error) {
      say(this._text, "");
      return;
    }
    say(this._text, `${degrees(error.angle).toFixed(1)}°  ${error.distance.toFixed(2)} m`);
    if (error.angle > Math.PI / 2 || this.shape === SHAPES[1]) return;
    const at = new THREE.Vector3(...focus).project(this.camera);
    const [x, y] = [(at.x * width) / 2, (-at.y * height) / 2];
    this._ring.style.display = this._line.style.display = "";
    this._ring.setAttribute("cx", x);
    this._ring.setAttribute("cy", y);
    this._line.setAttribute("x2", x);
    this._line.setAttribute("y2", y);
  }
}
