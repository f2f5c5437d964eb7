"""Bounds of robots' reach: robots out of each other's reach need no distance checks.

The frame of a joint lies as far from that of the joint before as it is mounted, and a prismatic joint adds its
position. So by the triangle inequality no point of a body is farther from the first joint's place than the sum of these
lengths along its chain and its own greatest distance from the frame that carries it.
"""

from dataclasses import dataclass

import numpy as np

from deltaq_cell.kernel.arrays import Anatomy
from deltaq_protocol.arrays import Array, Flags

_ROUNDING_M = 1e-6
"""Added to every radius: far more than arithmetic is off, or than a position may exceed its limit by rounding."""


@dataclass(frozen=True)
class RobotReach:
    """A ball that holds all bodies of a robot.

    Attributes:
        centre_m: (3,) in the world [m].
        radii_m: (bodies,) of each body with every prismatic joint at zero [m].
        slides: (bodies, n) which prismatic joints carry each body.
    """

    centre_m: Array
    radii_m: Array
    slides: Flags

    def radius_m(self, farthest: Array) -> float:
        """Radius of the ball [m] while no joint is farther from zero than `farthest` (n,) [rad or m]."""
        return float((self.radii_m + self.slides @ farthest).max()) + _ROUNDING_M


def reach_of(cell: Anatomy, joints: tuple[int, int], bodies: tuple[int, int]) -> RobotReach:
    """The reach of one robot.

    Args:
        cell: the fixed data of the cell.
        joints: the robot's first joint, and one more than its last.
        bodies: likewise for its bodies.
    """
    first, last = joints
    centre = cell.translation[first]
    radii, slides = [], np.zeros((bodies[1] - bodies[0], last - first), dtype=bool)
    for row, body in enumerate(range(*bodies)):
        corners = cell.corners[body, : cell.corner_count[body]]
        widest = cell.disc[body] + cell.ball[body]
        chain = _chain(cell, int(cell.carrier[body]))
        if not chain:  # it is given in the world
            radii.append(np.linalg.norm(corners - centre, axis=1).max() + widest)
            continue
        length = np.linalg.norm(cell.translation[chain[0]] - centre)
        length += sum(np.linalg.norm(cell.translation[joint]) for joint in chain[1:])
        radii.append(length + np.linalg.norm(corners, axis=1).max() + widest)
        slides[row] = [joint in chain and not cell.revolute[joint] for joint in range(first, last)]
    return RobotReach(centre, np.array(radii), slides)


def apart_m(
    one: RobotReach, other: RobotReach, farthest: tuple[Array | None, Array | None] = (None, None)
) -> float:
    """Bound from below of the distance between two robots [m]; of robots that can meet it is less than nothing.

    Args:
        one: reach of a robot.
        other: of another.
        farthest: (n,) of each robot, how far its joints are from zero [rad or m]; zero if not given.
    """
    distance_m = float(np.linalg.norm(one.centre_m - other.centre_m))
    for reach, of in zip((one, other), farthest, strict=True):
        distance_m -= reach.radius_m(np.zeros(reach.slides.shape[1]) if of is None else of)
    return distance_m


def _chain(cell: Anatomy, joint: int) -> list[int]:
    """The joints that carry something, from the first to `joint`; none for -1."""
    chain: list[int] = []
    while joint >= 0:
        chain.insert(0, joint)
        joint = int(cell.parent[joint])
    return chain
