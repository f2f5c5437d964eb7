"""Filters between a program and an arm, compared by what they let through and what they cost: `deltaq bench filters`.

A filter is a function `(q, dq) -> dq`: the arm is at `q` (n,) and is asked to move by `dq` (n,) in this cycle; what the
function returns is sent [rad or m]. A class is taken, too: `NAME(scene)` makes a filter for a `FilterScene`, and its
method `start(q)`, if it has one, is called where the arm is put to `q`.
"""

import inspect
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from deltaq import Gate, GateError
from deltaq.obstacles import numbers
from deltaq_experiments.bench.filter_scenes import Distances, FilterScene
from deltaq_protocol.arrays import Array
from deltaq_testing.scenario.model import ScenarioError
from deltaq_testing.scenario.run import resolved, where

ADVERSARIES = ("bang-bang", "homing", "to and fro")
HOLD = 60
"""Most cycles for which an adversary asks for the same."""
SAMPLE = 0.02
"""Greatest step of a joint between two configurations that are judged along a stop [rad or m]."""
WHOLE = 0.99
"""Share of a request along itself from which it counts as admitted."""


def no_filter(_q: Array, dq: Array) -> Array:
    """What is asked for."""
    return dq


class TheGate:
    """`deltaq.Gate`, with the stop distances of the scene."""

    def __init__(self, scene: FilterScene) -> None:
        self._gate = Gate.from_urdf(
            scene.urdf, scene.cycle_s, scene.obstacles, scene.q, srdf=scene.srdf,
            stop_distance_m=scene.stop_distance_m, self_stop_distance_m=scene.self_stop_distance_m,
        )  # fmt: skip

    def start(self, q: Array) -> None:
        """Begin anew at `q` (n,)."""
        self._gate.reset(q)

    def __call__(self, q: Array, dq: Array) -> Array:
        """The increment that the gate admits."""
        self._gate.observe(q)
        return self._gate.step(dq).dq


FILTERS: dict[str, Callable[..., Any]] = {"none": no_filter, "gate": TheGate}
"""Those that come with deltaq."""


def named(name: str) -> Callable[..., Any]:
    """A function or class by its name: one of `FILTERS`, `FILE.py:NAME` or `package.module:NAME`.

    Raises:
        GateError: there is none.
    """
    if name in FILTERS:
        return FILTERS[name]
    bound, value = f"must be {', '.join(FILTERS)}, FILE.py:NAME or package.module:NAME", name
    try:
        found = resolved(name, Path()) if all(name.rpartition(":")) else None
    except ScenarioError as error:
        found, value = None, str(error)
    if not callable(found):
        raise GateError("filter", value, bound, "name a function (q, dq) -> dq, or a class of such objects")
    filter: Callable[..., Any] = found
    return filter


@dataclass
class RequestAdversary:
    """Asks for the fastest increments: at random, straight at the nearest body, or there and away from it."""

    kind: str
    scene: FilterScene
    distances: Distances
    rng: np.random.Generator
    left: int = 0

    def wish(self, q: Array) -> Array:
        """(n,) increment wanted at `q` (n,) [rad or m]."""
        if self.left == 0:
            self.left = int(self.rng.integers(1, HOLD))
            nearest = np.array([self.distances.measure(q).argmin()])
            toward = -np.sign(self.distances.gradients(q, nearest)[0])
            sign = self.rng.choice([-1.0, 1.0]) if self.kind == "to and fro" else 1.0
            way = self.rng.choice([-1.0, 0.0, 1.0], len(q)) if self.kind == "bang-bang" else sign * toward
            self.dq = way * self.scene.max_velocity * self.scene.cycle_s
        self.left -= 1
        return self.dq


@dataclass
class Follower:
    """Asks for the next setpoint of a path, from where the arm has got to on it.

    Attributes:
        at: index of the setpoint that was reached.
    """

    path: Array
    at: float = 0.0

    def wish(self, q: Array) -> Array:
        """(n,) increment wanted at `q` (n,) [rad or m]."""
        return self._setpoint(self.at + 1) - q

    def moved(self, dq: Array) -> None:
        """Take how the arm has moved, (n,) [rad or m]."""
        way = self._setpoint(self.at + 1) - self._setpoint(self.at)
        length = float(way @ way)
        self.at += float(np.clip(way @ dq / length, 0.0, 1.0)) if length > 1e-18 else 1.0

    def _setpoint(self, at: float) -> Array:
        one = min(int(at), len(self.path) - 2)
        setpoint: Array = self.path[one] + min(at - one, 1.0) * (self.path[one + 1] - self.path[one])
        return setpoint


class DrivenArm:
    """Drives that follow increments as far as their acceleration limits allow; whole ones at once if `ideal`."""

    def __init__(self, scene: FilterScene, q: Array, ideal: bool) -> None:
        self._scene, self._ideal = scene, ideal
        self.q, self.dq = q, np.zeros_like(q)
        self._fastest = scene.max_velocity * scene.cycle_s
        self._change = scene.max_acceleration * scene.cycle_s**2

    def possible(self, wish: Array) -> Array:
        """(n,) increment on the way from the present one to what is wished for, within all limits."""
        wish = np.clip(wish, -self._fastest, self._fastest)
        far = float((np.abs(wish - self.dq) / self._change).max())
        return wish if far <= 1.0 else self.dq + (wish - self.dq) / far

    def move(self, dq: Array) -> None:
        """Go on by one cycle."""
        if not self._ideal:
            dq = np.clip(dq, self.dq - self._change, self.dq + self._change)
        dq = np.clip(dq, -self._fastest, self._fastest)
        q = np.clip(self.q + dq, self._scene.lower, self._scene.upper)
        self.q, self.dq = q, q - self.q

    def stop(self, dq: Array) -> Array:
        """(k, n) configurations of an increment and the straight stop after it."""
        cycles = max(1.0, np.ceil((np.abs(dq) / self._change).max()))
        travel = dq * (cycles + 1) / 2
        count = int(np.ceil(np.abs(travel).max() / SAMPLE)) + 1
        configurations: Array = self.q + np.linspace(0.0, 1.0, count + 1)[1:, None] * travel
        return configurations


@dataclass
class FilterRow:
    """The figures of one filter.

    Attributes:
        trials, contacts: how many, and in how many of them bodies touched.
        depth_m: how deep at most.
        cycles, false_holds: how many, and in how many of them a request was shortened that was clear with its stop.
        asked, kept: cycles that all paths take without a filter, and how many of them were travelled in that time.
        seconds: processor time of each call.
    """

    trials: int = 0
    contacts: int = 0
    depth_m: float = 0.0
    cycles: int = 0
    false_holds: int = 0
    asked: float = 0.0
    kept: float = 0.0
    seconds: list[float] = field(default_factory=list)

    def figures(self) -> dict[str, float]:
        """What is shown."""
        p50, p99 = np.percentile(self.seconds or [0.0], (50, 99)) * 1e3
        return {
            "trials": self.trials,
            "contacts": self.contacts,
            "worst_penetration_mm": round(self.depth_m * 1e3, 1),
            "false_holds_percent": round(100 * self.false_holds / max(1, self.cycles), 2),
            "speed_kept_percent": round(100 * self.kept / max(1.0, self.asked), 1),
            "p50_ms": round(float(p50), 3),
            "p99_ms": round(float(p99), 3),
        }


@dataclass
class FilterTrials:
    """Trials of one filter in one scene; what comes of them is added to its row.

    Attributes:
        ideal: whether drives follow at once.
    """

    name: str
    filter: Callable[..., Any]
    scene: FilterScene
    ideal: bool
    row: FilterRow

    def __post_init__(self) -> None:
        self._distances = Distances(self.scene)
        if inspect.isclass(self.filter):
            self.filter = self._call(self.filter, self.scene)

    def attack(self, cycles: int, seed: int) -> None:
        """Let each adversary ask for so many cycles."""
        for number, kind in enumerate(ADVERSARIES):
            rng = np.random.default_rng([seed, number])
            self._run(RequestAdversary(kind, self.scene, self._distances, rng), self.scene.q, cycles)

    def follow(self) -> None:
        """Follow each path for as long as it takes without a filter."""
        for path in self.scene.paths:
            follower, cycles = Follower(path), len(path) - 1
            self._run(follower, path[0], cycles)
            self.row.asked += cycles
            self.row.kept += min(follower.at, cycles)

    def _run(self, asker: RequestAdversary | Follower, q: Array, cycles: int) -> None:
        self._call(getattr(self.filter, "start", lambda _q: None), q.copy())
        arm, depth_m = DrivenArm(self.scene, q, self.ideal), 0.0
        for _ in range(cycles):
            request = arm.possible(asker.wish(arm.q))
            begin = time.process_time()
            answer = self._call(self.filter, arm.q.copy(), request.copy())
            self.row.seconds.append(time.process_time() - begin)
            stop, before = arm.stop(request), arm.q
            arm.move(numbers(self.name, answer, len(q), "return one increment for each joint", np.inf))
            moved = arm.q - before
            if moved @ request < WHOLE * (request @ request) - 1e-12:
                inside = ((stop >= self.scene.lower) & (stop <= self.scene.upper)).all()
                self.row.false_holds += bool(inside and all(map(self._distances.clear, stop)))
            if isinstance(asker, Follower):
                asker.moved(moved)
            depth_m = max(depth_m, self._distances.depth_m(arm.q))
        self.row.trials += 1
        self.row.cycles += cycles
        self.row.contacts += depth_m > 0.0
        self.row.depth_m = max(self.row.depth_m, depth_m)

    def _call(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a user's function returns.

        Raises:
            GateError: it raises.
        """
        try:
            return function(*arguments)
        except Exception as error:
            raise GateError(self.name, where(error), "must not raise", "correct it") from None


def compare(
    filters: Mapping[str, Callable[..., Any]],
    scene: FilterScene,
    rows: Mapping[str, FilterRow],
    cycles: int,
    seed: int,
    ideal: bool = False,
) -> Iterator[str]:
    """Send adversaries, for so many cycles each, and paths of a scene through filters; yields each name when done."""
    for name, filter in filters.items():
        trials = FilterTrials(name, filter, scene, ideal, rows[name])
        trials.attack(cycles, seed)
        trials.follow()
        yield name
