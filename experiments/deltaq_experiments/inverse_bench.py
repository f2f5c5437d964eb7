"""Inverse kinematics side by side on the arms of a cell: time, error, and branches that are missed.

`python -m deltaq_experiments.inverse_bench --cell lab`. Each arm is solved by the closed form that is its own, if it
has one, by EAIK's and numerically. Poses are those of random configurations within the limits, so that each can be
reached; what is found is put through pinocchio's forward kinematics.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from pydantic import BaseModel, ConfigDict

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.inverse.any_arm import AnyArm
from deltaq_controllers.inverse.arms import Arm, ArmInverse, inverted
from deltaq_controllers.inverse.branches import wrapped
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_launch.program import run_program
from deltaq_protocol.arrays import Array

TIMES = 3
SAME = 1e-6
"""A branch is found if no joint is farther away [rad]."""


class InverseRow(BaseModel):
    """One inverse of one arm.

    Attributes:
        robot: its name.
        hand: the arm's.
        inverse: `own`, the family that EAIK sees in the arm, or `numeric`.
        batch_us: processor time a pose, all at once, all branches, the best of three.
        single_us: the same, one pose a call.
        branches: mean number.
        missed: share of configurations that are not among the branches of their own pose.
        error: greatest error of any branch, by pinocchio [m or entry of a rotation].
    """

    model_config = ConfigDict(frozen=True)

    robot: str
    hand: str
    inverse: str
    batch_us: float
    single_us: float
    branches: float
    missed: float
    error: float


def run(cell_name: str, poses: int = 2000, seed: int = 0) -> list[InverseRow]:
    """Measure every arm of every robot of a cell.

    Args:
        cell_name: name or file of the cell.
        poses: how many.
        seed: of the configurations.

    Raises:
        TrackingError: a robot's hand has no arm of six joints.
    """
    rows = []
    for name, robot in CellModel.load(cell_name).robots.items():
        tracker = ConstraintTracker(robot)
        q = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (poses, robot.n))
        for arm in tracker.arms:
            wanted = _poses(tracker, arm, q)
            for kind, solver, T_own in _inverses(robot, arm):
                rows.append(_row(tracker, arm, q, (name, kind), solver, T_own @ wanted))
    return rows


def _inverses(robot: RobotModel, arm: Arm) -> Iterator[tuple[str, ArmInverse, Array]]:
    """Name and inverse, and (4, 4) what maps the first joint's frame into its base."""
    chain = arm.chain(robot)
    limits = robot.lower[arm.joints], robot.upper[arm.joints]
    if not isinstance(arm.solver, AnyArm):
        yield "own", arm.solver, inverted(arm.T_mount_base[None])[0]
    eaik = AnyArm(chain, *limits)
    if eaik.family:
        yield eaik.family, eaik, np.eye(4)
    yield "numeric", AnyArm(chain, *limits, numeric=True), np.eye(4)


def _row(
    tracker: ConstraintTracker,
    arm: Arm,
    q: Array,
    named: tuple[str, str],
    solver: ArmInverse,
    poses: Array,
) -> InverseRow:
    solver.inverse(poses[:2])
    branches = solver.inverse(poses)
    few = poses[:200]
    apart = np.abs(wrapped(branches.q - q[:, None, arm.joints])).max(axis=2)
    own = np.where(branches.exists, apart, np.inf).min(axis=1)
    error = 0.0
    for row in range(min(len(q), 200)):
        T = tracker.robot.forward(q[row], arm.hand)
        for found in branches.q[row][branches.exists[row]]:
            whole = q[row].copy()
            whole[arm.joints] = found
            error = max(error, float(np.abs(tracker.robot.forward(whole, arm.hand) - T).max()))
    return InverseRow(
        robot=named[0],
        hand=arm.hand,
        inverse=named[1],
        batch_us=_best_us(lambda: solver.inverse(poses), len(poses)),
        single_us=_best_us(lambda: [solver.inverse(pose) for pose in few], len(few)),
        branches=float(branches.exists.sum(axis=1).mean()),
        missed=float((own > SAME).mean()),
        error=error,
    )


def _poses(tracker: ConstraintTracker, arm: Arm, q: Array) -> Array:
    """(N, 4, 4) of the arm's tool in the frame of its first joint at zero."""
    kinematics = tracker.kinematics
    mounts = kinematics.mounts(kinematics.frames(q), int(arm.joints[0]), len(q))
    hands = np.stack([tracker.robot.forward(row, arm.hand) for row in q])
    T: Array = np.linalg.inv(mounts) @ hands
    return T @ arm.pose_of_last(kinematics, q) if arm.beyond else T


def _best_us(solve: Callable[[], object], count: int) -> float:
    times = []
    for _ in range(TIMES):
        began_s = time.process_time()
        solve()
        times.append(time.process_time() - began_s)
    return 1e6 * min(times) / count


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one table, or one JSON object."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_experiments.inverse_bench", description=__doc__)
    parser.add_argument("--cell", default="lab", help="name or file of a cell (default: %(default)s)")
    parser.add_argument("--poses", type=int, default=2000, help="of each arm (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    if given.poses < 1:
        parser.error(f"--poses {given.poses}: at least 1")
    rows = run(given.cell, given.poses, given.seed)
    if given.json:
        print("[" + ",\n".join(row.model_dump_json() for row in rows) + "]")
        return 0
    print("| robot | hand | inverse | batch, µs a pose | single, µs | branches | missed | greatest error |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        print(
            f"| {row.robot} | {row.hand} | {row.inverse} | {row.batch_us:.1f} | {row.single_us:.0f} | "
            f"{row.branches:.1f} | {100 * row.missed:.1f} % | {row.error:.0e} |"
        )
    return 0


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.inverse_bench")
