// Forward kinematics of a robot from scene.json, in float64. Matrices are 4x4, column-major, as three.js keeps them.

/** Product of two 4x4 matrices, a * b, written into `out`. */
export function multiply(a, b, out) {
  for (let column = 0; column < 4; column++) {
    const [x, y, z, w] = [b[4 * column], b[4 * column + 1], b[4 * column + 2], b[4 * column + 3]];
    for (let row = 0; row < 4; row++) {
      out[4 * column + row] = a[row] * x + a[4 + row] * y + a[8 + row] * z + a[12 + row] * w;
    }
  }
  return out;
}

function identity() {
  const out = new Float64Array(16);
  out[0] = out[5] = out[10] = out[15] = 1;
  return out;
}

/** Motion of a joint by q [rad or m] along or about its unit axis. */
function jointMotion(kind, axis, q, out = identity()) {
  const [x, y, z] = axis;
  if (kind === "prismatic") {
    out.fill(0);
    out[0] = out[5] = out[10] = out[15] = 1;
    out[12] = x * q;
    out[13] = y * q;
    out[14] = z * q;
    return out;
  }
  const [c, s] = [Math.cos(q), Math.sin(q)];
  const t = 1 - c;
  out[0] = t * x * x + c;
  out[1] = t * x * y + s * z;
  out[2] = t * x * z - s * y;
  out[4] = t * x * y - s * z;
  out[5] = t * y * y + c;
  out[6] = t * y * z + s * x;
  out[8] = t * x * z + s * y;
  out[9] = t * y * z - s * x;
  out[10] = t * z * z + c;
  out[3] = out[7] = out[11] = out[12] = out[13] = out[14] = 0;
  out[15] = 1;
  return out;
}

/** Placements of one robot's joints in the world. */
export class Kinematics {
  /** @param robot one robot of scene.json. */
  constructor(robot) {
    this.base = Float64Array.from(robot.T_world_base);
    this.joints = robot.joints.map((joint, index) => ({
      kind: joint.kind,
      axis: joint.axis,
      parent: joint.parent ?? index - 1,
      placement: Float64Array.from(joint.parent_T_joint),
    }));
    this.world = this.joints.map(identity);
    this._motion = identity();
    this._placed = identity();
  }

  /** Compute `world`, T_world_joint of each joint, at the configuration q [rad or m]. */
  place(q) {
    this.joints.forEach((joint, index) => {
      multiply(joint.placement, jointMotion(joint.kind, joint.axis, q[index], this._motion), this._placed);
      multiply(joint.parent < 0 ? this.base : this.world[joint.parent], this._placed, this.world[index]);
    });
    return this.world;
  }

  /** T_world_frame of a frame that joint `index` carries (-1: the base) at the last configuration placed. */
  carried(index, T_joint_frame) {
    return multiply(index < 0 ? this.base : this.world[index], T_joint_frame, identity());
  }
}
