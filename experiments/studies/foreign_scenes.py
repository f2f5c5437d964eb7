"""The gate alone among other people's scenes: `python -m studies.foreign_scenes --data FOLDER --output KEPT`.

Problems of MotionBenchMaker (Chamzas et al., RA-L 2022) for a UR5 and a Panda, in FOLDER/ur5 and FOLDER/panda with
URDF, SRDF, meshes and `problems.tar.bz2`. Each is planned with RRT-Connect (Kuffner and LaValle, ICRA 2000) and
shortcuts, clear by the stop distance on the meshes at every setpoint, and sent at full speed through `deltaq.Gate`.
`Distances` of `deltaq bench filters` judges every setpoint and where the robot would stop after it, on the meshes
themselves: no hull and no kernel of the gate's.
"""

from __future__ import annotations

import argparse
import json
import tarfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml

from deltaq import Box, Cylinder, Gate, GateError, Sphere
from deltaq.foreign_robot import whole_body
from deltaq.obstacles import Obstacle
from deltaq_deploy.launch.program import run_program
from deltaq_experiments.bench.filter_scenes import Distances, FilterScene, timed
from deltaq_protocol.arrays import Array

STOP_M, SELF_STOP_M = 0.005, 0.002
CYCLE_S = 0.004
ROUNDING_M = 1e-5
"""By which coal's distance to a mesh and to its hull may differ [m]."""
RESOLUTION = 0.04
"""Of the planner's checks: norm of a step in joint space [rad]."""
TRIES = 4000
"""Of the planner, after which a problem counts as not planned."""
PLANS = 5
"""That are made of a problem until one is clear at every setpoint, between the planner's checks, too."""
RAMP_S = 0.2
"""Time from a hold to full speed along the path [s]."""
PATIENCE = 250
"""Cycles without progress after which a path counts as blocked."""


def steps_between(one: Array, other: Array, resolution: float = RESOLUTION) -> Array:
    """(k, n) configurations on the line from `one` to `other`, the first left out."""
    count = max(1, int(np.ceil(np.linalg.norm(other - one) / resolution)))
    line: Array = one + np.linspace(0, 1, count + 1)[1:, None] * (other - one)
    return line


def plan(
    start: Array, goal: Array, lower: Array, upper: Array, clear: Callable[[Array], bool], rng: Any
) -> list[Array] | None:
    """A path of straight lines, by RRT-Connect and shortcuts; None if none was found."""
    trees: list[list[tuple[Array, int]]] = [[(start, -1)], [(goal, -1)]]

    def extend(tree: list[tuple[Array, int]], target: Array, most: float) -> Array:
        nearest = int(np.argmin(np.linalg.norm([q - target for q, _ in tree], axis=1)))
        at, last = tree[nearest][0], nearest
        for q in steps_between(at, target):
            if np.linalg.norm(q - at) > most or not clear(q):
                break
            tree.append((q, last))
            last = len(tree) - 1
        return tree[last][0]

    def way(tree: list[tuple[Array, int]], q: Array) -> list[Array]:
        index = next(i for i, (each, _) in enumerate(tree) if each is q)
        found = []
        while index >= 0:
            found.append(tree[index][0])
            index = tree[index][1]
        return found

    for number in range(TRIES):
        mine, theirs = trees[number % 2], trees[1 - number % 2]
        target = goal if number == 0 else rng.uniform(lower, upper)
        reached = extend(mine, target, 1.0)
        met = extend(theirs, reached, np.inf)
        if np.allclose(met, reached):
            path = way(mine, reached)[::-1] + way(theirs, met)
            return _shortened(path if number % 2 == 0 else path[::-1], clear, rng)
    return None


def _shortened(path: list[Array], clear: Callable[[Array], bool], rng: Any) -> list[Array]:
    for _ in range(80):
        if len(path) < 3:
            break
        i, j = sorted(rng.choice(len(path), 2, replace=False))
        if j - i > 1 and all(clear(q) for q in steps_between(path[i], path[j])):
            path = path[: i + 1] + path[j:]
    return path


def timed_path(path: list[Array], velocity: Array, acceleration: Array) -> Array:
    """(k, n) setpoints of all cycles: each line from rest to rest in the least time that the limits allow."""
    rows = [path[0][None]]
    for one, other in pairwise(path):
        if np.abs(other - one).max() > 1e-9:  # not where the planner's trees met
            rows.append(timed(one, other, velocity, acceleration, CYCLE_S)[1:])
    return np.vstack(rows)


@dataclass
class Scene:
    """Results of one scene.

    Attributes:
        problems, start_near, goal_near, not_planned: counted; the rest was streamed.
        refused: problems that `Gate` did not take, with its words.
        decisions, false_admissions: cycles, and those after which the oracle found a pair too near.
        clear_rad, admitted_rad: length of all paths, and of what was admitted of them.
        unfiltered_s, filtered_s: time of what was admitted, by the limits alone and through the gate.
        ms: processor time of each decision.
        causes: cycles that were limited, by reason; blocked: pairs at which a path ended.
    """

    problems: int = 0
    start_near: int = 0
    goal_near: int = 0
    not_planned: int = 0
    refused: list[str] = field(default_factory=list)
    decisions: int = 0
    false_admissions: int = 0
    clear_rad: float = 0.0
    admitted_rad: float = 0.0
    unfiltered_s: float = 0.0
    filtered_s: float = 0.0
    ms: list[float] = field(default_factory=list)
    causes: Counter[str] = field(default_factory=Counter)
    blocked: Counter[str] = field(default_factory=Counter)

    @classmethod
    def told(cls, figures: dict[str, Any]) -> Scene:
        """The scene of which `vars` made these figures."""
        return cls(**figures | {key: Counter(figures[key]) for key in ("causes", "blocked")})

    def __add__(self, other: Scene) -> Scene:
        """The figures of both."""
        return Scene(**{name: value + getattr(other, name) for name, value in vars(self).items()})

    def row(self) -> dict[str, Any]:
        """The figures to print."""
        told = {key: value for key, value in vars(self).items() if key not in ("ms", "causes", "blocked")}
        ms = np.array(self.ms or [0.0])
        return told | {
            "share_admitted": round(self.admitted_rad / max(self.clear_rad, 1e-9), 4),
            "speed_kept": round(self.unfiltered_s / max(self.filtered_s, 1e-9), 4),
            "p50_ms": round(float(np.percentile(ms, 50)), 3),
            "p99_ms": round(float(np.percentile(ms, 99)), 3),
            "causes": dict(self.causes.most_common(4)),
            "blocked": dict(self.blocked.most_common(3)),
        }


def stream(gate: Gate, oracle: Distances, path: Array, scene: Scene) -> None:
    """Send a path through the gate, along it as fast as the gate admits, and judge every setpoint."""
    at, rate, waits, cycles = 0.0, 1.0, 0, 0
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    index = np.arange(len(path))

    def along(places: Array) -> Array:
        return np.stack([np.interp(places, index, joint) for joint in path.T], axis=1)

    last = ""
    step = gate.would_admit(None, path[0] - path[0])
    while at < len(path) - 1 and waits < PATIENCE:
        ahead = min(at + rate, len(path) - 1.0)
        target = along(np.array([ahead]))[0]
        begin = time.process_time()
        step = gate.step(target - gate.q_cmd())
        scene.ms.append((time.process_time() - begin) * 1e3)
        cycles += 1
        # the stopping trajectory: dq times (N - k) / N for k of 1 to N
        rest = step.q_cmd + step.dq * max(0.0, (step.verdict.time_to_stop_s or 0.0) / CYCLE_S - 1) / 2
        if not (oracle.clear(step.q_cmd, -ROUNDING_M) and oracle.clear(rest, -ROUNDING_M)):
            scene.false_admissions += 1
        gone = ahead - at
        if not step.admitted:
            # a part of a request, or a step of the stopping trajectory, goes along the path, too
            near = np.minimum(at + np.linspace(0.0, 2.0, 81), len(path) - 1.0)
            gone = near[np.linalg.norm(along(near) - step.q_cmd, axis=1).argmin()] - at
        waits = waits + 1 if gone < 1e-3 else 0
        at += gone
        rate = min(1.0, gone + CYCLE_S / RAMP_S)
        if step.reasons:
            last = step.why.partition(":")[0]
            scene.causes[step.reasons[0].code.value] += 1
    scene.decisions += cycles
    scene.clear_rad += lengths[-1]
    scene.admitted_rad += float(np.interp(at, index, lengths))
    scene.unfiltered_s += at * CYCLE_S
    scene.filtered_s += (cycles - waits) * CYCLE_S
    if waits >= PATIENCE and step.verdict.pair is not None:
        bodies = (
            whole_body(name).removeprefix("arm/").removeprefix("structure/") for name in step.verdict.pair
        )
        on_mesh, on_hull = oracle.distance_m(step.q_cmd, *bodies), step.verdict.clearance_m or 0.0
        scene.blocked[
            f"{last}, {on_mesh * 1e3:.1f} mm on the mesh and {on_hull * 1e3:.1f} mm on the hull"
        ] += 1


def problems(folder: Path, every: int) -> Iterator[tuple[str, int, dict[str, Any], dict[str, Any]]]:
    """Name of the scene, number, scene and request of every so many-th problem; one of each scene after the other."""
    with tarfile.open(folder / "problems.tar.bz2") as archive:
        members = {member.name: member for member in archive.getmembers()}
        for name in sorted(
            (name for name in members if "/request" in name), key=lambda name: name[-9:] + name
        ):
            number = int(name[-9:-5])
            if (number - 1) % every == 0:
                read = [
                    archive.extractfile(members[each]) for each in (name.replace("request", "scene"), name)
                ]
                scene, request = (yaml.safe_load(file.read()) for file in read if file is not None)
                yield name.split("/")[-2], number, scene, request


def obstacles_of(scene: dict[str, Any]) -> dict[str, Obstacle]:
    """The bodies of a scene."""
    found: dict[str, Obstacle] = {}
    for number, item in enumerate(scene["world"]["collision_objects"]):
        for part, (shape, pose) in enumerate(zip(item["primitives"], item["primitive_poses"], strict=True)):
            place = _pose(item["pose"]) * _pose(pose) if "pose" in item else _pose(pose)
            rpy, size = _vector(pin.rpy.matrixToRpy(place.rotation)), shape["dimensions"]
            at = _vector(place.translation)
            made: Obstacle
            match shape["type"]:
                case "box":
                    made = Box(tuple(size), at=at, rpy=rpy)
                case "cylinder":
                    made = Cylinder(size[1], size[0], at=at, rpy=rpy)
                case _:
                    made = Sphere(size[0], at=at)
            found[f"body_{number}_{part}"] = made
    return found


def _vector(array: Array) -> tuple[float, float, float]:
    x, y, z = array.tolist()
    return x, y, z


def _pose(told: dict[str, Any]) -> pin.SE3:
    rotation = pin.Quaternion(np.array(told["orientation"], dtype=np.float64)).normalized().toRotationMatrix()
    return pin.SE3(rotation, np.array(told["position"], dtype=np.float64))


def solved(folder: Path, told: dict[str, Any], request: dict[str, Any], seed: int) -> Scene:
    """The figures of one problem."""
    urdf, srdf = folder / f"{folder.name}.urdf", folder / f"{folder.name}.srdf"
    scene = Scene(problems=1)
    start = dict(
        zip(*(request["start_state"]["joint_state"][key] for key in ("name", "position")), strict=True)
    )
    goal = {one["joint_name"]: one["position"] for one in request["goal_constraints"][0]["joint_constraints"]}
    obstacles = obstacles_of(told)
    try:
        gate = Gate.from_urdf(
            urdf, CYCLE_S, obstacles, [start[joint] for joint in goal], srdf=srdf, stop_distance_m=STOP_M,
            self_stop_distance_m=SELF_STOP_M, tolerance=1e-6,
        )  # fmt: skip
    except GateError as error:
        scene.refused.append(str(error)[:160])
        return scene
    robot = gate.cell.robots["arm"]
    oracle = Distances(FilterScene.of(gate, str(urdf), str(srdf)))
    clear = partial(oracle.clear, more_m=0.0)
    q, target = gate.q_cmd(), np.array([goal[joint] for joint in robot.joint_names])
    if not clear(q):
        scene.start_near += 1
    elif not clear(target):
        scene.goal_near += 1
    else:
        for number in range(PLANS):
            rng = np.random.default_rng((seed, number))
            path = plan(q, target, robot.lower, robot.upper, clear, rng)
            if path is None:
                break
            setpoints = timed_path(path, robot.max_velocity, robot.max_acceleration)
            if all(map(clear, setpoints)):
                stream(gate, oracle, setpoints, scene)
                return scene
        scene.not_planned += 1
    return scene


def run(folder: Path, every: int, seed: int, until: float, kept: Path) -> dict[str, Scene]:
    """Every so many-th problem of one robot, until a time of `time.monotonic`.

    Args:
        folder: of the robot.
        every: the first problem of each scene, then every so many-th.
        seed: of the planner.
        until: no problem is begun after it [s].
        kept: file with a line for each problem; those that it has are not done again.
    """
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    done = {(line["scene"], line["number"]): Scene.told(line["figures"]) for line in map(json.loads, lines)}
    with kept.open("a", encoding="utf-8") as file:
        for name, number, told, request in problems(folder, every):
            if time.monotonic() > until:
                break
            if (name, number) not in done:
                scene = done[name, number] = solved(folder, told, request, seed)
                print(name, number, json.dumps(scene.row()), flush=True)
                file.write(json.dumps({"scene": name, "number": number, "figures": vars(scene)}) + "\n")
                file.flush()
    return {
        name: sum((scene for (each, _), scene in done.items() if each == name), Scene())
        for name in sorted({name for name, _ in done})
    }


def main() -> None:
    """Print one row for each scene, and write all as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--robot", choices=("ur5", "panda"), action="append")
    parser.add_argument("--every", type=int, default=25)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit-s", type=float, default=1e9)
    parser.add_argument("--output", type=Path, required=True, help="folder; a run goes on from what it has")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for robot in options.robot or ("ur5", "panda"):
        until, kept = time.monotonic() + options.limit_s, options.output / f"{robot}.jsonl"
        scenes = run(options.data / robot, options.every, options.seed, until, kept)
        rows = {name: scene.row() for name, scene in scenes.items()}
        (options.output / f"{robot}.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
        print(json.dumps(rows, indent=1))


if __name__ == "__main__":
    run_program(main, "studies.foreign_scenes")
