// A follower's picture: live, or drawn by a second camera in the same scene; with a reticle, as an inset or large, plain
// or in stereo. Of several followers one is shown: the one that was chosen, or one that sees its target.

import { THREE } from "./vendor/three.js";
import { degrees, el, part, remember, remembered, say } from "./dom.js";
import { Video } from "./video.js";

const SHAPES = ["plain", "side by side", "red-cyan"];
const AUTOMATIC = "auto";
const MODEL = "model";
const LOOK_MS = 100; // between two looks whether a live picture is old
const FAR_M = 40;

/** Angle between view axis and focus [rad], and distance [m], of the camera pose T (16 numbers). */
function viewError(T, focus) {
  const line = [0, 1, 2].map((k) => focus[k] - T[12 + k]);
  const distance = Math.hypot(...line);
  const along = (line[0] * T[8] + line[1] * T[9] + line[2] * T[10]) / distance;
  return { angle: Math.acos(Math.min(1, Math.max(-1, along))), distance };
}

// Which of several cameras is shown: the present one for as long as it sees its target, then the first that does.

export const UNSEEN_MS = 1000; // a glance away does not hand over

export class Handover {
  constructor() {
    Object.assign(this, { present: 0, _lost_ms: null });
  }

  /**
   * The place of the camera to be shown.
   * @param seen of each camera, whether it sees its target; now in ms.
   */
  choose(seen, now) {
    if (seen[this.present]) {
      this._lost_ms = null;
      return this.present;
    }
    this._lost_ms ??= now;
    const next = seen.indexOf(true);
    if (next >= 0 && now - this._lost_ms >= UNSEEN_MS) this.take(next);
    return this.present;
  }

  /** Another camera is shown from now on. */
  take(place) {
    Object.assign(this, { present: place, _lost_ms: null });
  }
}

export class FollowerPicture {
  /** @param views RobotView of each robot; one at least carries a camera. */
  constructor(stage, live, views) {
    Object.assign(this, { stage, live, views, isLarge: false, handover: new Handover() });
    this.followers = views.filter(({ robot }) => robot.camera);
    this.camera = new THREE.PerspectiveCamera(45, 1.5, 0.05, FAR_M);
    this.camera.matrixAutoUpdate = false;
    this.videos = this.followers.map(({ robot }) => robot.camera.video.map((name) => new Video(live.connection, name, () => stage.ask())));
    this._build();
    this._choose(remembered("camera", AUTOMATIC));
    if (this.followers.length > 1) live.addEventListener("frame", () => this._handOver());
    stage.afterEach((renderer) => this._draw(renderer));
    for (const kind of ["line", "replay"]) live.addEventListener(kind, () => this._drawAnew());
    document.addEventListener("visibilitychange", () => this._drawAnew());
    live.addEventListener("shown", () => live.replay && this.eyes.forEach((video) => video.showRecorded(live.replay.picture(video.name))));
    if (this.videos.flat().length) setInterval(() => this._lookAtLive(), LOOK_MS);
  }

  /** RobotView whose camera is shown. */
  get view() {
    return this.followers[this.handover.present];
  }

  get settings() {
    return this.view.robot.camera;
  }

  /** Whether the live picture is shown, or that of a recording with one: to operators. */
  get isLive() {
    const [name] = this.settings.video;
    if (!name || this._source.value === MODEL || !this.live.hello?.operator) return false;
    return !this.live.replay || this.live.replay.hasPictures(name);
  }

  /** The live pictures that are shown, none, one, or those of both eyes. */
  get eyes() {
    return this.isLive ? this.videos[this.handover.present].slice(0, this._shape === SHAPES[0] ? 1 : 2) : [];
  }

  get shape() {
    if (this.isLive) return SHAPES[this.eyes.length - 1];
    return this.settings.baseline_m ? this._shape : SHAPES[0];
  }

  /** What a follower's camera is to look at: as the server says, else the hand of another robot. */
  focus(follower = this.view) {
    const told = this.live.shown?.robots[this.live.indexOf(follower.name)]?.focus;
    if (told) return told;
    const pose = this.views.find((view) => view !== follower)?.toolPose();
    return pose ? [pose[12], pose[13], pose[14]] : null;
  }

  error(follower = this.view) {
    const focus = this.focus(follower);
    return focus ? viewError(follower.cameraPose(), focus) : null;
  }

  toggle() {
    this.isLarge = !this.isLarge;
    this.box.dataset.large = String(this.isLarge);
    this.stage.ask();
  }

  /** Show the camera of that name, or leave it to the hand-over; a name that is not there does, too. */
  _choose(name) {
    const place = this.followers.findIndex((view) => view.name === name);
    this._isAutomatic = place < 0;
    this._cameras.value = this._isAutomatic ? AUTOMATIC : name;
    this._show(Math.max(0, place));
  }

  _show(place) {
    this.handover.take(place);
    this.camera.fov = degrees(this.settings.fov_rad);
    this._drawAnew();
  }

  _drawAnew() {
    this._inset = null;
    const eyes = this.eyes;
    for (const video of this.videos.flat()) video.isOn = eyes.includes(video) && !document.hidden && !this.live.replay;
    this._screen.hidden = !eyes.length;
    this._screen.replaceChildren(...eyes.map(({ canvas }) => canvas), this._fault);
    this._source.hidden = !this.settings.video.length;
    this._shapes.hidden = !this.settings.baseline_m || (this.isLive && this.settings.video.length < 2);
    this.stage.ask();
  }

  /** Say how old the live picture is, and grey it where it is too old, or frozen. */
  _lookAtLive() {
    const eyes = this.eyes;
    const fault = eyes.map((video) => video.fault).find((words) => words) ?? "";
    this._screen.toggleAttribute("data-fault", !!fault);
    say(this._fault, fault && `The live picture is ${fault}`);
    const glass_ms = Math.max(...eyes.map((video) => video.glass_ms));
    if (this.live.replay) say(this._age, "recorded");
    else say(this._age, eyes.length && !fault ? `live ${glass_ms.toFixed(0)} ms` : "live");
  }

  /** Show another camera where this one has lost its target and the other sees its own. */
  _handOver() {
    if (!this._isAutomatic || this.live.replay) return;
    const before = this.handover.present;
    const next = this.handover.choose(this.followers.map((follower) => this._sees(follower)), performance.now());
    if (next !== before) this._show(next);
  }

  /** Whether a follower's controller sees its target, and that is in its picture: another target may take a while. */
  _sees(follower) {
    const { name, robot } = follower;
    if (this.live.isStale(this.live.indexOf(name)) || this.live.robot(name)?.sight !== "fresh") return false;
    return this.error(follower)?.angle < robot.camera.fov_rad / 2;
  }

  _build() {
    this.box = part("follower");
    this._shape = remembered("stereo", SHAPES[Math.max(0, ...this.videos.map((eyes) => eyes.length - 1))]);
    [this._name, this._text] = [el("b"), el("output")];
    this._ring = el("circle", { r: 7, class: "ring" });
    this._line = el("line", { class: "miss" });
    this._reticle = el("svg", { class: "reticle", "aria-hidden": "true" },
      el("path", { d: "M-46 0h34M12 0h34M0 -46v34M0 12v34", class: "cross" }), el("circle", { r: 30, class: "cross faint" }), this._line, this._ring);
    const shapes = el("select", { class: "stereo", "aria-label": "Stereo" }, ...SHAPES.map((shape) => el("option", { selected: shape === this._shape }, shape)));
    shapes.addEventListener("change", () => {
      this._shape = shapes.value;
      remember("stereo", this._shape);
      this._drawAnew();
    });
    this._age = el("option", { value: "live" }, "live");
    this._source = el("select", { "aria-label": "Picture", title: "live, with its age from the lens to this page, or drawn from the model" }, this._age, el("option", {}, MODEL));
    this._source.value = remembered("picture", "live");
    this._source.addEventListener("change", () => {
      remember("picture", this._source.value);
      this._drawAnew();
    });
    this._fault = el("p", { role: "status" });
    this._screen = el("div", { class: "live", hidden: true });
    this._automatic = el("option", { value: AUTOMATIC });
    const options = this.followers.map(({ name }) => el("option", { value: name }, `${name} camera`));
    const cameras = el("select", { "aria-label": "Camera", title: "auto: another camera is shown when this one has lost its target" }, this._automatic, ...options);
    this._name.hidden = this.followers.length > 1;
    cameras.hidden = !this._name.hidden;
    cameras.addEventListener("change", () => {
      remember("camera", cameras.value);
      this._choose(cameras.value);
    });
    Object.assign(this, { _shapes: shapes, _cameras: cameras });
    this.box.append(
      this._screen,
      el("figcaption", {}, this._name, cameras, this._text, this._source, shapes,
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
    if (this.isLive) {
      const { width, height } = this.eyes[0].canvas;
      const scale = Math.min(box.width / width, box.height / height); // pixels are square: its view is that of the cell's file, upright
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this._place(this.view.cameraPose());
      this._aim(box, { width: scale * width, height: scale * height });
      return;
    }
    const left = box.left - holder.left;
    const bottom = holder.bottom - box.bottom;
    // as an inset every other picture is enough, where the processor draws; one of what stands still is finer, and has it
    const inset = [left, bottom, box.width, box.height];
    this._isSkipped = !this._isSkipped && !this.isLarge && inset.every((length, k) => length === this._inset?.[k]) && this.stage.keep(...inset);
    this._inset = inset;
    if (this._isSkipped) {
      this._place(this.view.cameraPose());
      this._aim(box);
      return;
    }
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

  /** Put the ring where the focus is in the picture, which fills the box or is in its middle, and say how far off it is. */
  _aim({ width, height }, picture = { width, height }) {
    const focus = this.focus();
    say(this._name, `${this.view.name} camera`);
    say(this._automatic, `${this.view.name} camera (auto)`);
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
    const [x, y] = [(at.x * picture.width) / 2, (-at.y * picture.height) / 2];
    this._ring.style.display = this._line.style.display = "";
    this._ring.setAttribute("cx", x);
    this._ring.setAttribute("cy", y);
    this._line.setAttribute("x2", x);
    this._line.setAttribute("y2", y);
  }
}
