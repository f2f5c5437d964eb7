"""All solutions of an inverse, and the choice among them."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from deltaq_protocol.arrays import Array, Flags
from deltaq_protocol.errors import DeltaqError

TURN = 2.0 * np.pi

FREE = 1e-13
"""Below this fraction of the arm's reach, or of a unit vector, a direction is rounding: the joint is free."""

REACH_TOLERANCE = 1e-12
"""How far rounding may carry `|cos|` of an elbow beyond 1 with the pose still being reached to 1e-12."""


class InverseError(DeltaqError):
    """Invalid poses."""


@dataclass(frozen=True)
class Branches:
    """All branches for N poses; N is missing from every shape where a single pose was asked for.

    There are K of them, eight in closed form.

    Attributes:
        q: (N, K, 6) configurations in (-pi, pi] [rad]; NaN where there is none.
        exists: (N, K) whether the branch reaches its pose; False for all of them is out of reach.
        free: names of joints, or of sums of joints, that the pose may leave free, each with (N,) flags; the
            solutions there carry the hint's value.
    """

    q: Array
    exists: Flags
    free: dict[str, Flags]

    def fitted(self, reference: Array, lower: Array, upper: Array) -> tuple[Array, Flags]:
        """Solutions moved by whole turns as near to a reference as the limits allow.

        Args:
            reference: (6,) or (N, 1, 6) configuration to be near to [rad].
            lower: (6,) lower limits [rad].
            upper: (6,) upper limits [rad].

        Returns:
            (N, K, 6) configurations, and (N, K) whether they exist inside the limits.
        """
        turns = np.rint((reference - self.q) / TURN)
        # of the turns that the limits allow, the one nearest to the reference
        turns = np.minimum(
            np.maximum(turns, np.ceil((lower - self.q) / TURN)), np.floor((upper - self.q) / TURN)
        )
        q = self.q + turns * TURN
        inside = self.exists & np.all((q >= lower) & (q <= upper), axis=-1)
        return q, inside

    def nearest(self, reference: Array, lower: Array, upper: Array) -> Array:
        """The solution inside the limits whose greatest difference of a joint from a reference is least.

        Args:
            reference: (6,) or (N, 1, 6) configuration [rad].
            lower: (6,) lower limits [rad].
            upper: (6,) upper limits [rad].

        Returns:
            (N, 6) configurations; NaN where no branch is inside the limits.
        """
        q, inside = self.fitted(reference, lower, upper)
        distance = np.where(inside, np.max(np.abs(q - reference), axis=-1), np.inf)
        best = np.argmin(distance, axis=-1)[..., None]
        found = np.take_along_axis(inside, best, axis=-1)
        chosen = np.take_along_axis(q, best[..., None], axis=-2)[..., 0, :]
        nearest: Array = np.where(found, chosen, np.nan)
        return nearest


class NumberedBranches(ABC):
    """A closed form with numbered branches: a branch has one number at all poses."""

    @abstractmethod
    def inverse(self, poses: Array, hint: Array | None = None) -> Branches:
        """All configurations that put the tool at each pose."""

    def near(self, poses: Array, reference: Array, lower: Array, upper: Array) -> Array:
        """(N, 6) solution inside the limits that is nearest to a reference (N, 6); NaN where there is none.

        Args:
            poses: (N, 4, 4) of the tool in the arm's base frame.
            reference: of each [rad]; the first gives joints that the pose leaves free.
            lower: (6,) lower limits [rad].
            upper: (6,) upper limits [rad].
        """
        hint = reference[0] if len(reference) else None
        return self.inverse(poses, hint).nearest(reference[:, None], lower, upper)

    def follow(self, poses: Array, start: Array) -> Array:
        """Configurations along paths, without a change of branch; limits are not checked.

        Args:
            poses: (N, P, 4, 4) of the tool in the arm's base frame.
            start: (N, 6) configurations that have it at the first of each path [rad].

        Returns:
            (N, P, 6) configurations, joints turning on beyond (-pi, pi]; NaN from where an arm cannot reach.
        """
        count, pieces = poses.shape[:2]
        branches = self.inverse(poses.reshape(-1, 4, 4), start[0] if count else None)
        q = np.where(branches.exists[:, :, None], branches.q, np.nan).reshape(count, pieces, 8, 6)
        # two branches touch in a singularity, where the nearest one may be the other
        branch = _largest(wrapped(q[:, 0] - start[:, None])).argmin(axis=1)
        followed = q[np.arange(count), :, branch]
        followed[:, 1:] = start[:, None] + np.cumsum(wrapped(np.diff(followed, axis=1)), axis=1)
        followed[:, 0] = start
        return followed

    def branch(self, pose: Array, q: Array) -> int:
        """Number of the branch that `q` (6,) [rad] is on, which puts the tool at a pose (4, 4)."""
        return int(_largest(wrapped(self.inverse(pose, q).q - q)).argmin())


def _largest(changes: Array) -> Array:
    """(...) largest change of a joint, of changes (..., 6); infinite where there is none."""
    largest: Array = np.abs(changes).max(axis=-1)
    return np.where(np.isfinite(largest), largest, np.inf)


def checked_poses(poses: Array) -> Array:
    """(N, 4, 4) of one pose or many.

    Raises:
        InverseError: the shape is neither (4, 4) nor (N, 4, 4).
    """
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim not in (2, 3) or poses.shape[-2:] != (4, 4):
        raise InverseError(
            f"poses must be homogeneous matrices of shape (4, 4) or (N, 4, 4), got {poses.shape}"
        )
    return poses.reshape(-1, 4, 4)


def checked_hint(hint: Array | None) -> Array:
    """(6,) configuration that gives free joints; zeros without one.

    Raises:
        InverseError: another shape, or not finite.
    """
    if hint is None:
        return np.zeros(6)
    hint = np.asarray(hint, dtype=np.float64)
    if hint.shape != (6,) or not np.isfinite(hint).all():
        raise InverseError(f"the hint must be six finite joint angles [rad], got {hint!r}")
    return hint


def wrapped(angle: Array) -> Array:
    """Angles by whole turns into (-pi, pi]."""
    angle = angle - TURN * np.rint(angle / TURN)
    result: Array = np.where(angle <= -np.pi, angle + TURN, angle)
    return result


def two_links(along: Array, across: Array, first: float, second: float) -> tuple[Array, Array, Array, Flags]:
    """Angles of a planar arm of two links that reaches a point.

    Args:
        along: coordinate along the arm's zero direction [m].
        across: coordinate towards positive angles [m].
        first: length of the first link [m].
        second: length of the second [m].

    Returns:
        The first joint's mean over both elbows, half of its difference between them, the second joint of the
        positive elbow, all [rad], and whether the point is in reach: the solutions are
        `(mean - half, elbow)` and `(mean + half, -elbow)`.
    """
    squared = along * along + across * across
    product = 2.0 * first * second
    cosine = (squared - (first * first + second * second)) / product
    reached = np.abs(cosine) <= 1.0 + REACH_TOLERANCE
    # sin^2 by factors: 1 - cos^2 would lose half of the digits near a stretched elbow
    distance = np.sqrt(squared)
    room = (
        ((first + second) ** 2 - squared)
        * (distance - abs(first - second))
        * (distance + abs(first - second))
    )
    sine = np.sqrt(np.maximum(room, 0.0)) / product
    elbow = np.arctan2(sine, cosine)
    half = np.arctan2(second * sine, first + second * cosine)
    return np.arctan2(across, along), half, elbow, reached
