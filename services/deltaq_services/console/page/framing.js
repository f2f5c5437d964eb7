// Where a camera has to stand so that it sees all of some points, as near as that allows.

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((value) => value / Math.hypot(...a));

/**
 * Eye and target of a camera that looks from the direction `from` (towards it, in the world, not straight down).
 * @param points [[x, y, z], ...] in m, at least one; wide, high tangents of half the angles of view.
 */
export function framed(points, from, wide, high) {
  const back = unit(from);
  const right = unit(cross([0, 0, 1], back));
  const up = cross(back, right);
  const seen = points.map((point) => [dot(point, right), dot(point, up), dot(point, back)]);
  // of each side of the picture the point that is nearest to it bounds where the eye may be
  const [across, upright] = [[0, wide], [1, high]].map(([k, tangent]) => {
    const [most, least] = [1, -1].map((sign) => Math.max(...seen.map((point) => sign * point[k] + tangent * point[2])));
    return { middle: (most - least) / 2, depth: (most + least) / (2 * tangent) };
  });
  const depth = Math.max(across.depth, upright.depth);
  const target = seen.reduce((sum, point) => sum + point[2], 0) / seen.length;
  const at = (far) => [0, 1, 2].map((k) => across.middle * right[k] + upright.middle * up[k] + far * back[k]);
  return { eye: at(depth), target: at(Math.min(target, depth - 0.5)) };
}
