// Geometry of bodies: Wavefront OBJ files and basic shapes, smoothed, coloured and merged to few draw calls.

import { THREE } from "./vendor/three.js";

const SHARP_RAD = 0.61; // edges sharper than 35 degrees stay edges

/** Positions of the triangles of an OBJ text: 9 numbers a triangle. */
function readObj(text) {
  const points = [];
  const positions = [];
  for (const line of text.split("\n")) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "v") points.push(words.slice(1, 4).map(Number));
    if (words[0] !== "f") continue;
    const corners = words.slice(1).map((word) => {
      const index = parseInt(word, 10);
      return points[index > 0 ? index - 1 : points.length + index];
    });
    for (let k = 2; k < corners.length; k++) positions.push(...corners[0], ...corners[k - 1], ...corners[k]);
  }
  return new Float32Array(positions);
}

/** Normals of a triangle soup: smooth over flat joints, sharp over creases, weighted by the corners' angles. */
function creasedNormals(positions) {
  const triangles = positions.length / 9;
  const faces = new Float32Array(triangles * 3);
  const [a, b, c] = [new THREE.Vector3(), new THREE.Vector3(), new THREE.Vector3()];
  const around = new Map();
  const key = (at) => `${Math.round(positions[at] * 1e4)},${Math.round(positions[at + 1] * 1e4)},${Math.round(positions[at + 2] * 1e4)}`;
  const weights = new Float32Array(triangles * 3);
  for (let t = 0; t < triangles; t++) {
    const corners = [0, 3, 6].map((k) => new THREE.Vector3().fromArray(positions, 9 * t + k));
    const normal = a.subVectors(corners[1], corners[0]).cross(b.subVectors(corners[2], corners[0]));
    if (normal.lengthSq() > 0) normal.normalize();
    normal.toArray(faces, 3 * t);
    for (let k = 0; k < 3; k++) {
      b.subVectors(corners[(k + 1) % 3], corners[k]);
      c.subVectors(corners[(k + 2) % 3], corners[k]);
      weights[3 * t + k] = b.lengthSq() * c.lengthSq() > 0 ? b.angleTo(c) : 0;
      const place = key(9 * t + 3 * k);
      if (!around.has(place)) around.set(place, []);
      around.get(place).push(3 * t + k);
    }
  }
  const normals = new Float32Array(positions.length);
  const cosine = Math.cos(SHARP_RAD);
  for (const corners of around.values()) {
    for (const corner of corners) {
      const own = 3 * Math.floor(corner / 3);
      a.set(0, 0, 0);
      for (const other of corners) {
        const at = 3 * Math.floor(other / 3);
        const along = faces[own] * faces[at] + faces[own + 1] * faces[at + 1] + faces[own + 2] * faces[at + 2];
        if (along >= cosine) a.addScaledVector(b.fromArray(faces, at), weights[other]);
      }
      (a.lengthSq() > 0 ? a.normalize() : a.fromArray(faces, own)).toArray(normals, 3 * corner);
    }
  }
  return normals;
}

// segments around, and from pole to equator: where the processor draws every triangle counts
const FULL = { around: 32, thin: 16, pole: 8 };
const LEAN = { around: 20, thin: 10, pole: 4 };

/** Geometry of a basic shape of scene.json, its frame at its centre, cylinders and capsules along z. */
function basicShape(kind, size, { around, thin, pole }) {
  if (kind === "box") return new THREE.BoxGeometry(...size);
  if (kind === "sphere") return new THREE.SphereGeometry(size[0], around, 2 * pole);
  const [radius, length] = size;
  const segments = radius < 0.05 ? thin : around;
  const geometry =
    kind === "capsule"
      ? new THREE.CapsuleGeometry(radius, length, pole, segments)
      : new THREE.CylinderGeometry(radius, radius, length, segments);
  return geometry.rotateX(Math.PI / 2); // three.js has them along y
}

/** Meshes are fetched once, whoever asks. */
export class MeshStore {
  /** @param fetchText fetches a file; isFull: as round as graphics hardware can have it. */
  constructor(fetchText, isFull) {
    this._fetchText = fetchText;
    this._segments = isFull ? FULL : LEAN;
    this._soups = new Map();
  }

  /** Geometry of one visual or structure body, without indices, in its own frame. */
  async geometry(body) {
    if (body.kind && body.kind !== "mesh") return basicShape(body.kind, body.size, this._segments).toNonIndexed();
    if (!this._soups.has(body.url)) {
      this._soups.set(
        body.url,
        this._fetchText(body.url).then((text) => {
          const positions = readObj(text);
          return { positions, normals: creasedNormals(positions) };
        }),
      );
    }
    const { positions, normals } = await this._soups.get(body.url);
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions.slice(), 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(normals.slice(), 3));
    return geometry;
  }
}

/** One geometry out of many: parts are {geometry, matrix (16 numbers), colour (THREE.Color)}; equal corners are one. */
export function merge(parts) {
  const corners = new Map();
  const [positions, normals, colours, index] = [[], [], [], []];
  for (const { geometry, matrix, colour } of parts) {
    const moved = geometry.clone().applyMatrix4(new THREE.Matrix4().fromArray(matrix));
    const { position, normal } = moved.attributes;
    for (let k = 0; k < position.count; k++) {
      const corner = [position.getX(k), position.getY(k), position.getZ(k), normal.getX(k), normal.getY(k), normal.getZ(k)];
      const key = `${corner.map((number) => Math.round(number * 1e4)).join()},${colour.getHex()}`;
      if (!corners.has(key)) {
        corners.set(key, corners.size);
        positions.push(...corner.slice(0, 3));
        normals.push(...corner.slice(3));
        colours.push(colour.r, colour.g, colour.b);
      }
      index.push(corners.get(key));
    }
    moved.dispose();
  }
  const merged = new THREE.BufferGeometry();
  merged.setAttribute("position", new THREE.Float32BufferAttribute(positions, 3));
  merged.setAttribute("normal", new THREE.Float32BufferAttribute(normals, 3));
  merged.setAttribute("color", new THREE.Float32BufferAttribute(colours, 3));
  merged.setIndex(index);
  return merged;
}
