// Where a pointer's ray drags a handle to: along an axis, or about one. Vectors are arrays of three numbers.

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

const PARALLEL = 0.02; // less than a degree between ray and axis, or ray and plane: the pointer tells nothing

/**
 * Place on the line `origin + s * axis` that is nearest to a ray [m]; null if ray and line are nearly parallel.
 * `ray` is {origin, direction}; axis and direction are unit vectors.
 */
export function alongAxis(ray, origin, axis) {
  const between = minus(ray.origin, origin);
  const c = dot(axis, ray.direction);
  const sine2 = 1 - c * c;
  if (sine2 < PARALLEL * PARALLEL) return null;
  return (dot(between, axis) - c * dot(between, ray.direction)) / sine2;
}

/** Angle about `axis` at which a ray meets the plane through `origin` [rad], from the direction `zero`; null if it does not. */
export function aboutAxis(ray, origin, axis, zero) {
  const slope = dot(ray.direction, axis);
  if (Math.abs(slope) < PARALLEL) return null;
  const far = dot(minus(origin, ray.origin), axis) / slope;
  if (far < 0) return null;
  const at = minus(ray.origin.map((value, k) => value + far * ray.direction[k]), origin);
  return Math.atan2(dot(cross(zero, at), axis), dot(zero, at));
}

/** Quaternion w, x, y, z of the rotation in a pose of 16 numbers, column by column. */
export function quaternionOf(T) {
  const [xx, yx, zx, , xy, yy, zy, , xz, yz, zz] = T;
  const sizes = [xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy];
  const largest = sizes.indexOf(Math.max(...sizes));
  const four = 2 * Math.sqrt(1 + sizes[largest]);
  const q = [
    [four / 4, (zy - yz) / four, (xz - zx) / four, (yx - xy) / four],
    [(zy - yz) / four, four / 4, (xy + yx) / four, (xz + zx) / four],
    [(xz - zx) / four, (xy + yx) / four, four / 4, (yz + zy) / four],
    [(yx - xy) / four, (xz + zx) / four, (yz + zy) / four, four / 4],
  ][largest];
  return q[0] < 0 ? q.map((part) => -part) : q;
}

/** The pose T turned by `angle` about a unit axis of the world through its own origin. */
export function turned(T, axis, angle) {
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const out = Float64Array.from(T);
  for (let column = 0; column < 3; column++) {
    const v = [T[4 * column], T[4 * column + 1], T[4 * column + 2]];
    const [side, along] = [cross(axis, v), dot(axis, v) * (1 - c)];
    for (let row = 0; row < 3; row++) out[4 * column + row] = c * v[row] + s * side[row] + along * axis[row];
  }
  return out;
}

/** The pose T (16 numbers, by columns) turned to the angles A B C about z, y, x [°]. */
export function withAngles(T, angles) {
  const [[ca, sa], [cb, sb], [cc, sc]] = angles.map((angle) => (angle * Math.PI) / 180).map((angle) => [Math.cos(angle), Math.sin(angle)]);
  const turn = [ca * cb, sa * cb, -sb, 0, ca * sb * sc - sa * cc, sa * sb * sc + ca * cc, cb * sc, 0, ca * sb * cc + sa * sc, sa * sb * cc - ca * sc, cb * cc, 0];
  return Float64Array.from([...turn, ...T.slice(12)]);
}
