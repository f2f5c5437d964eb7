"""What a user would take in place of the gate, and a comparison on MotionBenchMaker.

    deltaq bench filters none gate experiments/studies/filters_compared.py:Servo
    python -m studies.filters_compared --data FOLDER
    python -m studies.filters_compared --drawn 2

Each filter measures the distances on the meshes (`Distances`), as the judge does. FOLDER is that of
`studies.foreign_scenes`; each of its problems is planned, and the path and the adversaries go through each filter.
Drawn are scenes of the bench with example-robot-data's UR5.
"""

import argparse
import json
import math
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import daqp
import numpy as np

from deltaq import Gate, GateError
from deltaq_deploy.launch.program import run_program
from deltaq_experiments.bench.filter_scenes import Distances, FilterScene, drawn_scene
from deltaq_experiments.bench.filters import FILTERS, FilterRow, compare
from deltaq_protocol.arrays import Array
from studies.foreign_scenes import (
    CYCLE_S,
    PLANS,
    SELF_STOP_M,
    STOP_M,
    obstacles_of,
    plan,
    problems,
    timed_path,
)

UR5 = "package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
UR5_HOME = (0.0, -1.2, 1.2, -1.5, -1.5, 0.0)


class Threshold:
    """Holds where the next setpoint is nearer than a stop distance, unless it is farther than the present one."""

    def __init__(self, scene: FilterScene) -> None:
        self._distances = Distances(scene)

    def __call__(self, q: Array, dq: Array) -> Array:
        """See `deltaq_experiments.bench.filters`."""
        ahead = self._room_m(q + dq)
        return dq if ahead >= 0.0 or ahead > self._room_m(q) else np.zeros_like(dq)

    def _room_m(self, q: Array) -> float:
        return float((self._distances.measure(q) - self._distances.least_m).min())


class Servo:
    """MoveIt Servo's slowing down before collisions, with the defaults of its parameters.

    At its own rate Servo measures the least distances d between links and from obstacles. Until the next measurement it
    scales all motion by exp(k (d - threshold)), k = -ln(0.001) / threshold, where d is below its threshold, and by 0
    in a collision.
    """

    RATE_HZ = 10.0  # collision_check_rate
    SELF_M, SCENE_M = 0.01, 0.02  # self_ and scene_collision_proximity_threshold

    def __init__(self, scene: FilterScene) -> None:
        self._distances = Distances(scene)
        self._every = round(1 / self.RATE_HZ / scene.cycle_s)
        self._cycle, self._scale = 0, 1.0

    def __call__(self, q: Array, dq: Array) -> Array:
        """See `deltaq_experiments.bench.filters`."""
        if self._cycle % self._every == 0:
            found, own = self._distances.measure(q), self._distances.own
            self._scale = min(slowed(found[:own], self.SELF_M), slowed(found[own:], self.SCENE_M))
        self._cycle += 1
        return self._scale * dq


class WideServo(Servo):
    """`Servo` with a rate and a threshold from obstacles for a fast arm."""

    RATE_HZ, SCENE_M = 100.0, 0.1


def slowed(distances: Array, threshold_m: float) -> float:
    """Servo's scale for some distances [m]."""
    least = distances.min(initial=np.inf)
    return 0.0 if least <= 0.0 else math.exp(min(0.0, -math.log(0.001) / threshold_m * (least - threshold_m)))


class Barrier:
    """A control barrier filter as cbfpy's documentation describes it, for joint velocities u.

    The filter minimises |u - u_asked|^2 so that grad h u >= -alpha(h), with h the distance less the stop distance of
    each pair and velocity limits. Slack has a price, so that there is always a solution. In cbfpy's example with an
    obstacle alpha(h) = 3 h.
    """

    ALPHA = 3.0  # [1/s]
    PRICE = 1e3
    FASTEST_M_S = 3.0  # at which two bodies approach, so that farther pairs need no row

    def __init__(self, scene: FilterScene) -> None:
        self._distances, self._cycle_s = Distances(scene), scene.cycle_s
        self._fastest = scene.max_velocity

    def __call__(self, q: Array, dq: Array) -> Array:
        """See `deltaq_experiments.bench.filters`."""
        n, h = len(q), self._distances.measure(q) - self._distances.least_m
        near = np.flatnonzero(self.ALPHA * h < self.FASTEST_M_S)
        rows = np.hstack([self._distances.gradients(q, near), np.ones((len(near), 1))])
        weights = np.diag([*np.ones(n), self.PRICE])
        linear = np.append(-dq / self._cycle_s, 0.0)
        high = np.concatenate([self._fastest, [1e30], np.full(len(near), 1e30)])
        low = np.concatenate([-self._fastest, [0.0], -self.ALPHA * h[near]])
        u, _, found, _ = daqp.solve(weights, linear, rows, high, low)
        return u[:n] * self._cycle_s if found == 1 else np.zeros(n)


class QuickBarrier(Barrier):
    """`Barrier` that brakes later."""

    ALPHA = 10.0


OTHERS = {
    "threshold": Threshold,
    "servo": Servo,
    "servo, wide": WideServo,
    "barrier": Barrier,
    "barrier, quick": QuickBarrier,
}


def scene_of(folder: Path, told: dict[str, Any], request: dict[str, Any]) -> FilterScene | None:
    """The scene of a problem of MotionBenchMaker with a path that solves it; None without one."""
    urdf, srdf = folder / f"{folder.name}.urdf", folder / f"{folder.name}.srdf"
    at = dict(zip(*(request["start_state"]["joint_state"][key] for key in ("name", "position")), strict=True))
    goal = {
        each["joint_name"]: each["position"] for each in request["goal_constraints"][0]["joint_constraints"]
    }
    start = [at[joint] for joint in goal]
    gate = Gate.from_urdf(
        urdf, CYCLE_S, obstacles_of(told), start, srdf=srdf, stop_distance_m=STOP_M,
        self_stop_distance_m=SELF_STOP_M,
    )  # fmt: skip
    scene = FilterScene.of(gate, str(urdf), str(srdf))
    target = np.array([goal[joint] for joint in gate.cell.robots["arm"].joint_names])
    clear = Distances(scene).clear
    if not (clear(scene.q) and clear(target)):
        return None
    for seed in range(PLANS):
        path = plan(scene.q, target, scene.lower, scene.upper, clear, np.random.default_rng(seed))
        if path is None:
            return None
        setpoints = timed_path(path, scene.max_velocity, scene.max_acceleration)
        if all(map(clear, setpoints)):
            return replace(scene, paths=[setpoints])
    return None


def scenes(options: argparse.Namespace) -> Iterator[tuple[str, int, FilterScene | None]]:
    """Name, number and scene: those that are drawn, then every so many-th of the problems."""
    for seed in range(options.drawn):
        yield "drawn", seed, drawn_scene(seed, UR5, UR5_HOME)
    if options.data is not None:
        folder = options.data / options.robot
        for name, number, told, request in problems(folder, options.every):
            try:
                yield name, number, scene_of(folder, told, request)
            except GateError as error:
                print(name, number, error, flush=True)


def main() -> None:
    """Add up the figures of each filter over the scenes of a robot, and print them after each scene."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--drawn", type=int, default=0, help="scenes of a UR5")
    parser.add_argument("--robot", choices=("ur5", "panda"), default="panda")
    parser.add_argument("--every", type=int, default=50)
    parser.add_argument("--cycles", type=int, default=250, help="of each adversary")
    parser.add_argument("--ideal-drives", action="store_true")
    parser.add_argument("--limit-s", type=float, default=1e9, help="no problem is begun after it")
    options = parser.parse_args()
    until, filters = time.monotonic() + options.limit_s, {**FILTERS, **OTHERS}
    rows, done = {name: FilterRow() for name in filters}, 0
    for name, number, scene in scenes(options):
        if time.monotonic() > until:
            break
        if scene is not None:
            done += 1
            list(compare(filters, scene, rows, options.cycles, number, options.ideal_drives))
            figures = {each: row.figures() for each, row in rows.items()}
            print(name, number, done, json.dumps(figures), flush=True)


if __name__ == "__main__":
    run_program(main, "studies.filters_compared")
