// The stage: renderer, floor, orbit and views, and the loop that draws only what has changed.

import { OrbitControls, THREE } from "./vendor/three.js";
import { Floor } from "./floor.js";
import { Pace, Screen } from "./pace.js";
import { ROOMS, Shading } from "./shading.js";

const SHADOW_EVERY_MS = { full: 0, lean: 500 };
const LOOK_MS = 4; // after which it is looked whether a picture is finished, where the processor draws
const STILL_FINENESS = 2; // drawn twice as fine as the page, and so without jagged edges

/** Whether WebGL is computed by the processor; throws where the browser has none. */
function softwareRendered() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) throw new Error("This browser has no WebGL 2, which draws the cell. Switch on its graphics acceleration, or use another browser.");
  const told = gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(told ? gl.getParameter(told.UNMASKED_RENDERER_WEBGL) : "");
}

export class Stage {
  /**
   * @param holder element that the canvas fills.
   * @param floorHeight of the floor [m].
   * @param quality "full", "lean" or "auto".
   */
  constructor(holder, { floorHeight, quality }) {
    this.holder = holder;
    const byProcessor = softwareRendered();
    this.full = quality === "full" || (quality === "auto" && !byProcessor);
    this.renderer = new THREE.WebGLRenderer({ antialias: this.full, preserveDrawingBuffer: !this.full, powerPreference: "high-performance" });
    const finest = this.full ? Math.min(window.devicePixelRatio, 2) : 1;
    this.pace = new Pace(this.renderer.getContext(), finest, !this.full);
    this.shading = new Shading(this.full);
    this.renderer.shadowMap.enabled = this.full;
    this.renderer.shadowMap.type = THREE.PCFSoftShadowMap;
    this.renderer.shadowMap.autoUpdate = false;
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this._screen = this.full ? null : new Screen(this.renderer.domElement);
    this.canvas = this._screen?.canvas ?? this.renderer.domElement;
    this.canvas.tabIndex = 0;
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "The cell in three dimensions; drag to turn, wheel to zoom");
    holder.append(this.canvas);

    this.scene = new THREE.Scene(); // everything that is drawn
    this.solid = new THREE.Scene(); // what casts shadows
    this.floor = new Floor(floorHeight, this.full);
    this.marks = new THREE.Group(); // lines and volumes that explain
    this.scene.add(this.solid, this.floor.mesh, this.marks, ...this.shading.lights);
    this.camera = new THREE.PerspectiveCamera(34, 1, 0.1, 60);
    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, this.canvas);
    Object.assign(this.orbit, { enableDamping: true, dampingFactor: 0.18, maxPolarAngle: Math.PI * 0.51, maxDistance: 22 });
    this.orbit.addEventListener("change", () => this.ask());
    this.enter(true);

    this._before = [];
    this._after = [];
    this._ahead = [];
    this._wanted = this._moved = true;
    this._isUnseen = false; // whether a picture was begun that is not on the page yet
    this._timer = null;
    this._shadowAt = -Infinity;
    this._size = new THREE.Vector2();
    this.frames = 0;
    new ResizeObserver(() => this._fit()).observe(holder);
    this._fit();
    this._step = this._step.bind(this);
    this._look = this._look.bind(this);
    requestAnimationFrame(this._step);
  }

  /** Ask for a picture; `moved` if something that casts a shadow has moved. */
  ask(moved = false) {
    this._wanted = true;
    this._moved ||= moved;
  }

  /**
   * Let a part of the page as it was for one picture, so that nothing need be drawn there: in pixels of the page, from
   * below. Returns whether it stays; not where graphics hardware draws, which begins each picture anew, nor where the
   * last picture was finer or coarser.
   */
  keep(x, y, width, height) {
    if (!this._screen?.maySkip) return false;
    const ratio = this.renderer.getPixelRatio();
    this._screen.keep([x, y, width, height].map((length) => Math.round(ratio * length)));
    return true;
  }

  /** Call `action(now_ms)` whenever another picture may be begun, ahead of it. */
  beforeEach(action) {
    this._before.push(action);
  }

  /** Call `action(renderer)` once, ahead of the next picture, which then covers whatever it drew. */
  onceAhead(action) {
    this._ahead.push(action);
    this.ask();
  }

  /** Call `action(renderer, now_ms)` after each picture that was drawn. */
  afterEach(action) {
    this._after.push(action);
  }

  /** Whether what is shown is as fine as it gets, and nothing is waiting to be drawn. */
  isFinest() {
    return !this._wanted && !this._glide && !this._isUnseen && (this.full || this.renderer.getPixelRatio() === STILL_FINENESS);
  }

  /** Light or dark room. */
  enter(dark) {
    const room = ROOMS[dark ? "dark" : "light"];
    this.air = new THREE.Color(room.air);
    this.renderer.setClearColor(this.air, 1);
    this.shading.enter(room);
    this.floor.enter(room);
    this.ask(true);
  }

  /** Let the camera look from `eye` at `target` (both [x, y, z] in m), gliding there. */
  view(eye, target, glide = true) {
    this._glide = { eye: new THREE.Vector3(...eye), target: new THREE.Vector3(...target) };
    if (!glide) this._glideBy(1);
    this.ask();
  }

  /** Look at all of the cell from where the camera is. */
  fit(box, glide = true) {
    const ball = box.getBoundingSphere(new THREE.Sphere());
    const narrow = Math.min(1, this.camera.aspect);
    const distance = (0.8 * ball.radius) / Math.sin(THREE.MathUtils.degToRad(this.camera.fov / 2)) / narrow;
    const direction = this.camera.position.clone().sub(this.orbit.target).normalize();
    this.view(ball.center.clone().addScaledVector(direction, distance), ball.center, glide);
  }

  _glideBy(share) {
    const { eye, target } = this._glide;
    this.camera.position.lerp(eye, share);
    this.orbit.target.lerp(target, share);
    this.orbit.update();
    if (this.camera.position.distanceTo(eye) < 0.01) this._glide = null;
  }

  _fit() {
    const { clientWidth: width, clientHeight: height } = this.holder;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.pace.finest);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.ask();
  }

  _step(now) {
    requestAnimationFrame(this._step);
    if (this._glide) {
      this._glideBy(0.16);
      this._wanted = true;
    }
    this.orbit.update();
    this._drawIfDue(now);
  }

  /** Between two frames of the screen: show a picture as soon as it is finished, and begin the next. */
  _look() {
    this._drawIfDue(performance.now());
    this._timer = this._isUnseen ? setTimeout(this._look, LOOK_MS) : null;
  }

  _drawIfDue(now) {
    if (document.hidden || !this.pace.isFinished(now)) return;
    if (this._isUnseen) this._screen.show();
    this._isUnseen = false;
    for (const action of this._before) action(now);
    if (!this.pace.isDue(now)) return;
    const ratio = this.renderer.getPixelRatio();
    if (this._wanted) this._draw(now, this.pace.next());
    else if (this.pace.isStill(now) && ratio < STILL_FINENESS) this._draw(now, STILL_FINENESS);
  }

  _draw(now, fineness) {
    if (this.renderer.getPixelRatio() !== fineness) this.renderer.setPixelRatio(fineness);
    this._wanted = false;
    if (this._moved && now - this._shadowAt >= SHADOW_EVERY_MS[this.full ? "full" : "lean"]) {
      this._moved = false;
      this._shadowAt = now;
      this.renderer.shadowMap.needsUpdate = this.full;
      this.floor.cast(this.renderer, this.solid);
    }
    for (const action of this._ahead.splice(0)) action(this.renderer);
    this.renderer.render(this.scene, this.camera);
    this.frames += 1;
    for (const action of this._after) action(this.renderer, now);
    if (this._moved) this._wanted = true;
    this.pace.begun(now);
    if (!this._screen) return;
    this._isUnseen = true;
    this._timer ??= setTimeout(this._look, LOOK_MS);
  }
}
