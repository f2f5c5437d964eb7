"""The inverse of any arm of six revolute joints, from its description alone.

Where EAIK knows how to decompose the arm - a spherical wrist or shoulder, three parallel axes and more (Ostermeier,
Kuelz and Althoff, "Automatic Geometric Decomposition for Analytical Inverse Kinematics", 2025) - it gives all branches
in closed form, which are then refined to the last digit and checked. For any other arm, and where EAIK is not
installed, Newton's method from many starts finds most branches, some forty times slower.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.inverse.branches import Branches, checked_hint, checked_poses
from deltaq_controllers.inverse.chain import (
    JOINTS,
    STEPS,
    Chain,
    determinant_of,
    followed,
    placed,
    refined_all,
)
from deltaq_protocol.arrays import Array

try:
    from eaik.pybindings import EAIK
except ImportError:  # an extra of its own
    EAIK = None

HAS_CLOSED_FORMS = EAIK is not None
"""Whether the extra `arms` is installed."""

BRANCHES = 8
"""Branches in closed form; an arm with a known decomposition has no more."""

STARTS = 48
"""Starts for an arm without a closed form."""

CLOSE = 1e-3
"""Error within which a solution of the closed form is one; EAIK also gives the nearest pose to one out of reach."""

NEIGHBOUR = 0.5
"""From a configuration that is no farther away, Newton's method finds the branch that is nearest [rad]."""


class AnyArm:
    """Inverse kinematics of six revolute joints in a row.

    The branches of a pose have no order; along a path they are distinguished by following it.

    Args:
        chain: the joints, at zero, in the base frame.
        lower: (6,) lower limits, among which the numeric search begins [rad].
        upper: (6,) upper limits.
        numeric: do without the closed form.

    Attributes:
        family: kinematic family that EAIK sees in the arm; empty where branches are searched for.
    """

    def __init__(self, chain: Chain, lower: Array, upper: Array, *, numeric: bool = False) -> None:
        self.chain = chain
        self._reach_m = float(np.linalg.norm(chain.offsets[1:], axis=1).sum())
        self._robot: Any = None if numeric else known(chain)
        self.family = "" if self._robot is None else str(self._robot.get_kinematic_family())
        # the same starts every time: the same question has the same answer
        self._starts = np.random.default_rng(0).uniform(lower, upper, (STARTS, JOINTS))
        self._compile(lower, upper)

    def inverse(self, poses: Array, hint: Array | None = None) -> Branches:
        """The configurations that put the tool at each pose.

        Args:
            poses: (4, 4) or (N, 4, 4) poses of the tool in the chain's base frame; the rotations must be rotations.
            hint: (6,) configuration [rad] from which one more solution is looked for: in a singularity, where joints
                are free, it has the hint's values.

        Returns:
            Branches, existing ones first. No joint is marked as free.

        Raises:
            InverseError: poses or hint have another shape.
        """
        batch = checked_poses(poses)
        q, exists = self._solved(batch, None if hint is None else checked_hint(hint))
        return Branches(q[0], exists[0], {}) if np.ndim(poses) == 2 else Branches(q, exists, {})

    def near(self, poses: Array, reference: Array, lower: Array, upper: Array) -> Array:
        """(N, 6) solution inside the limits that is nearest to a reference (N, 6); NaN where there is none."""
        given = self._in_reach(poses)
        found, exists = self._refined(poses, reference[:, None], given[:, None], np.full(1, np.inf))
        q, inside = Branches(found, exists, {}).fitted(reference[:, None], lower, upper)
        nearest: Array = np.where(inside, q[:, 0], np.nan)
        far = np.flatnonzero(given & ~(np.abs(nearest - reference).max(axis=1) <= NEIGHBOUR))
        if len(far):
            all_of_them = Branches(*self._solved(poses[far], reference[far[0]]), {})
            nearest[far] = all_of_them.nearest(reference[far, None], lower, upper)
        return nearest

    def follow(self, poses: Array, start: Array) -> Array:
        """Configurations along paths, without a change of branch.

        Args:
            poses: (N, P, 4, 4) of the tool.
            start: (N, 6) configurations that have it at the first of each path.

        Returns:
            (N, P, 6) configurations, joints turning on beyond (-pi, pi]; NaN from where an arm cannot reach.
        """
        given = self._in_reach(poses)
        return followed(self.chain, np.array(poses, order="C"), np.array(start, order="C"), given)

    def branch(self, _pose: Array, q: Array) -> int:
        """0 or 1, by the sign of the Jacobian's determinant at `q` (6,): between the two lie singularities."""
        return int(determinant_of(placed(self.chain, np.array(q))[2]) > 0.0)

    def _compile(self, lower: Array, upper: Array) -> None:
        """Run the compiled functions once, so that no lease waits for compilation."""
        q = 0.5 * (lower + upper)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3], _ = placed(self.chain, q)
        self.near(pose[None], q[None], lower, upper)
        self.follow(pose[None, None], q[None])
        self.branch(pose, q)

    def _in_reach(self, poses: Array) -> NDArray[np.bool_]:
        """(...) whether poses (..., 4, 4) are finite and no farther away than the links are long together."""
        with np.errstate(invalid="ignore", over="ignore"):
            away = np.linalg.norm(poses[..., :3, 3] - self.chain.offsets[0], axis=-1)
        in_reach: NDArray[np.bool_] = np.isfinite(poses).all(axis=(-2, -1)) & (away <= self._reach_m + 1e-9)
        return in_reach

    def _solved(self, poses: Array, hint: Array | None) -> tuple[Array, NDArray[np.bool_]]:
        """(N, K, 6) distinct solutions, NaN where there are no more, and (N, K) whether there is one."""
        given = self._in_reach(poses)
        starts, near = self._closed_form(poses, given) if self.family else self._everywhere(len(poses))
        if hint is not None:
            hinted = np.broadcast_to(hint, (len(poses), 1, JOINTS))
            starts, near = np.concatenate([starts, hinted], axis=1), np.append(near, np.inf)
        tried = given[:, None] & np.isfinite(starts).all(axis=2)
        q, exists = self._refined(poses, starts, tried, near)
        most = max(BRANCHES, int(exists.sum(axis=1).max(initial=0)))
        return q[:, :most], exists[:, :most]

    def _closed_form(self, poses: Array, given: NDArray[np.bool_]) -> tuple[Array, Array]:
        """(N, K, 6) EAIK's solutions, NaN where there are fewer, and (K,) their tolerances."""
        starts = np.full((len(poses), BRANCHES, JOINTS), np.nan)
        rows = np.flatnonzero(given)
        found = self._robot.calculate_IK_batched(list(poses[rows]), 1) if len(rows) else []
        for row, solutions in zip(rows, found, strict=True):
            q = solutions.Q
            starts[row, : len(q)] = q
        return starts, np.full(BRANCHES, CLOSE)

    def _everywhere(self, count: int) -> tuple[Array, Array]:
        """(N, K, 6) the starts of a search, and (K,) that each counts however far away."""
        return np.broadcast_to(self._starts, (count, *self._starts.shape)), np.full(STARTS, np.inf)

    def _refined(
        self, poses: Array, starts: Array, tried: NDArray[np.bool_], near: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        # one kind of array each: another one would cause a compilation
        return refined_all(
            self.chain,
            np.array(poses, order="C"),
            np.array(starts, order="C"),
            np.array(tried, order="C"),
            near,
            STEPS,
        )


def known(chain: Chain) -> Any:
    """EAIK's robot; None if EAIK knows no decomposition, or is not installed."""
    if EAIK is None:
        return None
    robot = EAIK.Robot(chain.axes.T, chain.offsets.T, chain.rotation, [], True)
    return robot if robot.has_known_decomposition() else None
