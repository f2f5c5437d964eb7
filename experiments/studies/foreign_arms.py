"""Adversaries against the gate on public arms: `python -m studies.foreign_arms --decisions 20000`.

Each arm of example-robot-data stands among bodies drawn from a seed and is asked for what no friendly program asks: the
fastest increments that change at random (bang-bang), straight at the nearest body (homing), and away from it and back
(retreat). `Distances` judges every setpoint and where the robot would stop after it, on the meshes.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from deltaq import Box, Gate, GateError
from deltaq_cell.models import RobotModelError, load_urdf
from deltaq_cell.urdf_parsing import parse_model
from deltaq_deploy.launch.program import run_program
from deltaq_experiments.bench.filter_scenes import Distances, FilterScene
from deltaq_protocol.arrays import Array
from studies.foreign_scenes import CYCLE_S, ROUNDING_M, SELF_STOP_M, STOP_M

ROBOTS = "package://example-robot-data/robots"
ARMS = {
    "UR10": ("ur_description/urdf/ur10_robot.urdf", ""),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_joint"),
    "UR3": ("ur_description/urdf/ur3_robot.urdf", ""),
    "Baxter, left arm": ("baxter_description/urdf/baxter.urdf", "left_"),
    "Baxter, right arm": ("baxter_description/urdf/baxter.urdf", "right_"),
    "Z1": ("z1_description/urdf/z1.urdf", "joint"),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_joint_"),
    "iiwa": ("package://pybullet_data/kuka_iiwa/model.urdf", ""),
    "xArm": ("xarm_description/urdf/xarm7.urdf", "joint"),
    "TIAGo, arm": ("tiago_description/robots/tiago.urdf", "arm_"),
    "ANYmal, leg": ("anymal_b_simple_description/robots/anymal.urdf", "LF_"),
    "gantry of our own": ("kr16_gantry", ""),
}
"""File, and beginnings of the names of the joints that move; the others are locked. The iiwa comes with pybullet."""

BODIES = 12
HOLD = 60
"""Most cycles for which an adversary asks for the same."""


def locks(urdf: str, moving: str) -> dict[str, float]:
    """The joints that do not move, at zero or the middle of their limits [rad or m]."""
    model = parse_model(load_urdf(urdf), {})
    found = {}
    for index, name in enumerate(list(model.names)[1:]):
        if moving and not name.startswith(tuple(moving.split("|"))):
            at = model.joints[index + 1].idx_q
            low, high = float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at])
            found[name] = 0.0 if low <= 0.0 <= high else (low + high) / 2
    return found


def surrounded(gate: Gate, rng: Any) -> None:
    """Place boxes within reach, none of which overlaps the arm."""
    q = gate.q_cmd()
    robot = gate.cell.robots["arm"]
    reach = np.linalg.norm(robot.forward(q)[:3, 3] - robot.T_world_base[:3, 3]) + 0.1
    while len(gate.obstacles) < BODIES:
        at = robot.T_world_base[:3, 3] + rng.uniform(-reach, reach, 3)
        try:
            gate.place(f"body_{len(gate.obstacles)}", Box(rng.uniform(0.05, 0.2, 3), at=tuple(at)))
            near = gate.nearest()
            if near is not None and near.distance_m < 2 * STOP_M and "structure" in near.pair[1]:
                gate.remove(f"body_{len(gate.obstacles) - 1}")
        except GateError:
            continue


def asked(kind: int, gate: Gate, fastest: Array, rng: Any) -> Array:
    """(n,) increment of an adversary: 0 bang-bang, 1 homing on the nearest pair, 2 retreat and return."""
    if kind == 0:
        return np.asarray(rng.choice([-1.0, 0.0, 1.0], len(fastest)) * fastest)
    robot, near = gate.cell.robots["arm"], gate.nearest()
    if near is None:
        return fastest
    J = robot.jacobian(gate.q_cmd())[:3]
    toward = np.sign((np.array(near.points_m[1]) - np.array(near.points_m[0])) @ J)
    return np.asarray(toward * fastest * (1.0 if kind == 1 else rng.choice([-1.0, 1.0])))


def free(urdf: str, moving: str, rng: Any) -> Gate:
    """A gate whose arm stands clear of itself, at zero or at one of some configurations that are drawn.

    Raises:
        GateError: it does so nowhere.
    """
    locked, q = locks(urdf, moving), None
    for tries in range(40):
        try:
            gate = Gate.from_urdf(
                urdf, CYCLE_S, q=q, locked=locked, stop_distance_m=STOP_M, self_stop_distance_m=SELF_STOP_M,
                tolerance=1e-6,
            )  # fmt: skip
            oracle = Distances(FilterScene.of(gate, urdf))
            near = gate.nearest()
            if oracle.clear(gate.q_cmd(), 0.0) and (near is None or near.distance_m > SELF_STOP_M):
                return gate
        except GateError:
            if tries == 39:
                raise
        model = parse_model(load_urdf(urdf), locked)
        low, high = (
            np.clip(limit, -np.pi, np.pi) for limit in (model.lowerPositionLimit, model.upperPositionLimit)
        )
        q = rng.uniform(low, high)
    raise GateError("q", urdf, "must be clear of itself in one of 40 configurations", "name a start")


def attack(urdf: str, moving: str, decisions: int, seed: int) -> dict[str, Any]:
    """The figures of one arm."""
    rng = np.random.default_rng(seed)
    gate = free(urdf, moving, rng)
    surrounded(gate, rng)
    robot = gate.cell.robots["arm"]
    oracle = Distances(FilterScene.of(gate, urdf))
    near_at_start = not oracle.clear(gate.q_cmd(), -ROUNDING_M)
    fastest, ms, violations, moved = robot.max_velocity * CYCLE_S, [], 0, 0
    outcomes: dict[str, int] = {}
    wish, left, kind = fastest, 0, 0
    for _ in range(decisions):
        if left == 0:
            kind, left = int(rng.integers(3)), int(rng.integers(1, HOLD))
            wish = asked(kind, gate, fastest, rng)
        left -= 1
        begin = time.process_time()
        step = gate.step(wish)
        ms.append((time.process_time() - begin) * 1e3)
        outcomes[step.outcome.value] = outcomes.get(step.outcome.value, 0) + 1
        moved += bool(step.dq.any())
        rest = step.q_cmd + step.dq * max(0.0, (step.verdict.time_to_stop_s or 0.0) / CYCLE_S - 1) / 2
        violations += not (oracle.clear(step.q_cmd, -ROUNDING_M) and oracle.clear(rest, -ROUNDING_M))
    return {
        "joints": robot.n, "decisions": decisions, "violations": violations, "near_at_start": near_at_start,
        "moved": round(moved / decisions, 3), "outcomes": outcomes,
        "p50_ms": round(float(np.percentile(ms, 50)), 3), "p99_ms": round(float(np.percentile(ms, 99)), 3),
    }  # fmt: skip


def main() -> None:
    """Print one row for each arm."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--decisions", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--arm", choices=sorted(ARMS), action="append")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    rows = {}
    for name in options.arm or ARMS:
        file, moving = ARMS[name]
        try:
            rows[name] = attack(
                file if "//" in file or "/" not in file else f"{ROBOTS}/{file}",
                moving,
                options.decisions,
                options.seed,
            )
        except (GateError, RobotModelError) as error:
            rows[name] = {"refused": str(error)[:300]}
        print(name, json.dumps(rows[name]), flush=True)
        if options.output is not None:
            options.output.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    run_program(main, "studies.foreign_arms")
