// The floor with its metre grid and the soft shadows of what stands and moves on it: the cell is drawn once from the
// sun into a small picture, which the floor shows blurred.

import { THREE } from "./vendor/three.js";
import { SUN } from "./shading.js";

const SIDE_PX = { full: 1024, lean: 256 };
const REACH_M = 7; // half the side of the region that can have shadows

const VERTEX = `
  uniform mat4 fromSun; varying vec2 place; varying vec2 lit; varying float far;
  void main() {
    vec4 at = modelMatrix * vec4(position, 1.0);
    place = at.xy;
    lit = (fromSun * at).xy * 0.5 + 0.5;
    far = length(at.xy);
    gl_Position = projectionMatrix * viewMatrix * at;
  }`;
const FRAGMENT = `
  uniform sampler2D tile; uniform sampler2D shadows; uniform vec3 air; uniform float depth;
  varying vec2 place; varying vec2 lit; varying float far;
  void main() {
    vec3 colour = texture2D(tile, place).rgb;
    float shade = texture2D(shadows, lit).r;
    #ifdef SOFT
    vec2 o = vec2(0.0032, 0.0018);
    shade = 0.25 * (texture2D(shadows, lit + o.xy, 1.5).r + texture2D(shadows, lit - o.xy, 1.5).r
      + texture2D(shadows, lit + vec2(-o.y, o.x), 1.5).r + texture2D(shadows, lit + vec2(o.y, -o.x), 1.5).r);
    #endif
    colour *= 1.0 - depth * (1.0 - shade);
    gl_FragColor = vec4(mix(colour, air, smoothstep(4.0, 11.0, far)), 1.0);
  }`;

/** A tile of 1 m with a line around it. */
function tile(room, full) {
  const size = 256;
  const canvas = Object.assign(document.createElement("canvas"), { width: size, height: size });
  const pen = canvas.getContext("2d");
  pen.fillStyle = room.floor;
  pen.fillRect(0, 0, size, size);
  pen.strokeStyle = room.line;
  pen.lineWidth = 3;
  pen.strokeRect(0, 0, size, size);
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  // dear where the processor draws
  texture.anisotropy = full ? 8 : 1;
  texture.minFilter = full ? THREE.LinearMipmapLinearFilter : THREE.LinearMipmapNearestFilter;
  return texture;
}

export class Floor {
  /** @param height [m]; full as `Shading` has it. */
  constructor(height, full) {
    this._full = full;
    this._sun = new THREE.OrthographicCamera(-REACH_M, REACH_M, REACH_M, -REACH_M, 0.1, 30);
    this._sun.up.set(0, 1, 0);
    this._sun.position.copy(SUN).multiplyScalar(15);
    this._sun.lookAt(0, 0, 0);
    this._sun.updateMatrixWorld();
    const side = full ? SIDE_PX.full : SIDE_PX.lean; // coarse is soft too
    this._picture = new THREE.WebGLRenderTarget(side, side, {
      generateMipmaps: full,
      minFilter: full ? THREE.LinearMipmapLinearFilter : THREE.LinearFilter,
      depthBuffer: false,
    });
    this._black = new THREE.MeshBasicMaterial({ color: "#000000", side: THREE.DoubleSide, depthTest: false });
    this.material = new THREE.ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      defines: full ? { SOFT: 1 } : {},
      uniforms: {
        fromSun: { value: new THREE.Matrix4().multiplyMatrices(this._sun.projectionMatrix, this._sun.matrixWorldInverse) },
        tile: { value: null },
        shadows: { value: this._picture.texture },
        air: { value: new THREE.Color() },
        depth: { value: 0.5 },
      },
    });
    this.mesh = new THREE.Mesh(new THREE.CircleGeometry(11, 48), this.material);
    this.mesh.position.z = height + 0.001;
    this.mesh.renderOrder = 1; // after what hides it
  }

  enter(room) {
    const { uniforms } = this.material;
    uniforms.tile.value?.dispose();
    uniforms.tile.value = tile(room, this._full);
    // shown as written, without the screen's curve
    uniforms.air.value.setStyle(room.air, THREE.LinearSRGBColorSpace);
    uniforms.depth.value = room.shadow;
  }

  /** Draw the shadows of `casters` anew. */
  cast(renderer, casters) {
    const [target, colour, alpha] = [renderer.getRenderTarget(), new THREE.Color(), renderer.getClearAlpha()];
    renderer.getClearColor(colour);
    renderer.setRenderTarget(this._picture);
    renderer.setClearColor("#ffffff", 1);
    renderer.clear();
    casters.overrideMaterial = this._black;
    const background = casters.background;
    casters.background = null;
    renderer.render(casters, this._sun);
    casters.background = background;
    casters.overrideMaterial = null;
    renderer.setRenderTarget(target);
    renderer.setClearColor(colour, alpha);
  }
}
