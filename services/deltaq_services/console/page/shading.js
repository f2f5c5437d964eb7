// How solid things look. Two ways: `full` for graphics hardware, and `lean`, lit at the corners of the triangles, for
// browsers that compute WebGL with the processor. Both use the same lights.

import { THREE } from "./vendor/three.js";

export const SUN = new THREE.Vector3(-0.42, 0.34, 0.84).normalize();
const RIM = new THREE.Vector3(0.72, -0.62, 0.31).normalize();

/** Lights and floor of the light and the dark room. */
export const ROOMS = {
  dark: { air: "#161b22", floor: "#232a33", line: "#39424e", sky: "#dfe8f5", ground: "#3a3f49", shadow: 0.62 },
  light: { air: "#e9edf2", floor: "#dde2e8", line: "#bcc5d0", sky: "#ffffff", ground: "#a9a49c", shadow: 0.34 },
};

const LEAN_VERTEX = `
  uniform vec3 sun; uniform vec3 rim; uniform vec3 sky; uniform vec3 ground; uniform vec3 tint;
  attribute vec3 color; varying vec3 shade;
  vec3 screen(vec3 c) { // the ACES curve of Narkowicz, then sRGB's
    c = c * (2.51 * c + 0.03) / (c * (2.43 * c + 0.59) + 0.14);
    return pow(clamp(c, 0.0, 1.0), vec3(0.4545));
  }
  void main() {
    vec4 at = modelMatrix * vec4(position, 1.0);
    vec3 n = normalize(mat3(modelMatrix) * normal);
    vec3 toEye = normalize(cameraPosition - at.xyz);
    float shine = pow(max(dot(n, normalize(sun + toEye)), 0.0), 28.0);
    vec3 light = mix(ground, sky, 0.5 + 0.5 * n.z) * 0.48 + vec3(1.0, 0.95, 0.88) * 0.95 * max(dot(n, sun), 0.0)
      + vec3(0.55, 0.7, 1.0) * 0.22 * max(dot(n, rim), 0.0);
    light *= 0.82 + 0.18 * clamp(at.z * 1.5, 0.0, 1.0); // less light reaches what is low
    shade = screen(color * tint * light + 0.10 * shine);
    gl_Position = projectionMatrix * viewMatrix * at;
  }`;
const LEAN_FRAGMENT = `varying vec3 shade; void main() { gl_FragColor = vec4(shade, 1.0); }`;

/** Makes and keeps the materials of solid things, and lights them for the light or the dark room. */
export class Shading {
  constructor(full) {
    this.full = full;
    this.materials = [];
    this.lights = [];
    if (!full) return;
    this.fill = new THREE.HemisphereLight("#ffffff", "#404854", 1.3);
    this.sun = new THREE.DirectionalLight("#fff3e4", 2.6);
    this.sun.position.copy(SUN).multiplyScalar(10);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(2048, 2048);
    Object.assign(this.sun.shadow.camera, { left: -6, right: 6, top: 6, bottom: -6, near: 1, far: 20 });
    Object.assign(this.sun.shadow, { bias: -0.0005, normalBias: 0.025, radius: 4 });
    const rim = new THREE.DirectionalLight("#a9c7ff", 0.7);
    rim.position.copy(RIM).multiplyScalar(10);
    this.lights = [this.fill, this.sun, this.sun.target, rim];
  }

  /** A material for geometry with colours in its vertices; `tint` multiplies them. */
  material({ tint = "#ffffff", roughness = 0.5 } = {}) {
    const material = this.full
      ? new THREE.MeshStandardMaterial({ vertexColors: true, roughness, metalness: 0.05, color: tint })
      : new THREE.ShaderMaterial({
          vertexShader: LEAN_VERTEX,
          fragmentShader: LEAN_FRAGMENT,
          uniforms: {
            sun: { value: SUN },
            rim: { value: RIM },
            sky: { value: new THREE.Color() },
            ground: { value: new THREE.Color() },
            tint: { value: new THREE.Color(tint) },
          },
        });
    this.materials.push(material);
    return material;
  }

  /** Light everything for a room of `ROOMS`. */
  enter(room) {
    if (this.full) {
      this.fill.color.set(room.sky);
      this.fill.groundColor.set(room.ground);
      return;
    }
    for (const { uniforms } of this.materials) {
      uniforms.sky.value.set(room.sky);
      uniforms.ground.value.set(room.ground);
    }
  }
}
