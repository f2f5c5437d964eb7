// Small pictures of a robot at configurations where it is not, drawn in a corner of the stage ahead of its own picture.

import { THREE } from "./vendor/three.js";

const WIDE_PX = 216;
const HIGH_PX = 132;

export class Thumbnails {
  constructor(stage) {
    this.stage = stage;
    this._camera = new THREE.PerspectiveCamera(30, WIDE_PX / HIGH_PX, 0.1, 60);
    this._camera.up.set(0, 0, 1);
  }

  /** A canvas that will show `view`'s robot at q. */
  of(view, q) {
    const canvas = Object.assign(document.createElement("canvas"), { width: WIDE_PX, height: HIGH_PX });
    this.stage.onceAhead((renderer) => this._draw(renderer, view, q, canvas));
    return canvas;
  }

  _draw(renderer, view, q, canvas) {
    const { scene, marks } = this.stage;
    const before = view.q;
    view.place(q);
    this._aim(view);
    const ratio = renderer.getPixelRatio();
    const [width, height] = [WIDE_PX / ratio, HIGH_PX / ratio];
    marks.visible = false;
    renderer.setScissorTest(true);
    renderer.setViewport(0, 0, width, height);
    renderer.setScissor(0, 0, width, height);
    renderer.render(scene, this._camera);
    renderer.setScissorTest(false);
    const size = renderer.getSize(new THREE.Vector2());
    renderer.setViewport(0, 0, size.x, size.y);
    marks.visible = true;
    view.place(before);
    const screen = renderer.domElement;
    canvas.getContext("2d").drawImage(screen, 0, screen.height - HIGH_PX, WIDE_PX, HIGH_PX, 0, 0, WIDE_PX, HIGH_PX);
  }

  /** Look at the arm from where one looks at the cell. */
  _aim(view) {
    const arm = view.robot.joints.flatMap((joint, index) => (joint.kind === "revolute" ? [view.kinematics.world[index]] : []));
    const box = new THREE.Box3().setFromPoints([...arm, view.toolPose()].map((T) => new THREE.Vector3(T[12], T[13], T[14])));
    const middle = box.getCenter(new THREE.Vector3());
    const radius = box.getSize(new THREE.Vector3()).length() / 2 + 0.25;
    const direction = this.stage.camera.position.clone().sub(this.stage.orbit.target).normalize();
    this._camera.position.copy(middle).addScaledVector(direction, radius / Math.sin(THREE.MathUtils.degToRad(15)));
    this._camera.lookAt(middle);
    this._camera.updateMatrixWorld(true);
  }
}
