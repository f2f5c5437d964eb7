"""Both robots driven by adversaries over links that lose, delay, duplicate and reorder: does the gate hold?

One seed is one run. The independent checker measures every cycle of both robots, as recorded by the emulated
controllers; the gate's own figures are not used.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from deltaq_cell.robot import RobotModel
from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, ServerState, Supervision
from deltaq_protocol.messages import Phase
from deltaq_testing.oracle import ClearanceOracle, GateCounts, LimitCounts, limit_violations
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.parts import Link, MessageWire, Process

Tactic = Callable[[Array, Array], Array]
"""(n,) own setpoint and (3,) the other robot's tool [m] to (n,) increment."""


class Adversary:
    """Changes its tactic at random times, from a seed.

    Args:
        robot: the robot that it drives.
        cycle_s: sample time of the robot.
        random: source of all its choices.
    """

    def __init__(self, robot: RobotModel, cycle_s: float, random: np.random.Generator) -> None:
        self._robot = robot
        self._random = random
        self._fastest = robot.max_velocity * cycle_s
        self._left = 0
        self._tactic: Tactic = self._noise
        self._aim = np.zeros(robot.n)
        self._count = 0
        self.tactic_name = ""

    def increment(self, q_cmd: Array, target_m: Array) -> Array:
        """The next attack, (n,) [rad or m]."""
        if self._left == 0:
            tactics: tuple[Tactic, ...] = (
                self._noise, self._homing, self._limit_rider, self._brake_and_bolt, self._alternating,
                self._runaway, self._return,
            )  # fmt: skip
            self._tactic = tactics[int(self._random.integers(len(tactics)))]
            self.tactic_name = self._tactic.__name__.lstrip("_")
            self._left = int(self._random.integers(10, 150))
            self._aim = self._random.uniform(-1.0, 1.0, self._robot.n)
        self._left -= 1
        self._count += 1
        return self._tactic(q_cmd, target_m)

    def _noise(self, q_cmd: Array, _target_m: Array) -> Array:
        return self._random.uniform(-1.5, 1.5, q_cmd.size) * self._fastest

    def _homing(self, q_cmd: Array, target_m: Array) -> Array:
        """Move the tool towards the other robot's tool at full speed."""
        J = self._robot.jacobian(q_cmd)[:3]
        towards = target_m - self._robot.forward(q_cmd)[:3, 3]
        dq = J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), towards)
        return self._at_full_speed(dq)

    def _limit_rider(self, q_cmd: Array, _target_m: Array) -> Array:
        """Each joint moves to one of its limits."""
        limit = np.where(self._aim > 0, self._robot.upper, self._robot.lower)
        return np.clip(limit - q_cmd, -self._fastest, self._fastest)

    def _brake_and_bolt(self, q_cmd: Array, _target_m: Array) -> Array:
        """Nothing for a while, then everything at once."""
        return self._at_full_speed(self._aim) if self._count % 20 < 12 else np.zeros_like(q_cmd)

    def _alternating(self, _q_cmd: Array, _target_m: Array) -> Array:
        return (1.0 if self._count % 2 else -1.0) * self._at_full_speed(self._aim)

    def _runaway(self, _q_cmd: Array, _target_m: Array) -> Array:
        return 3.0 * self._at_full_speed(self._aim)

    def _return(self, q_cmd: Array, _target_m: Array) -> Array:
        """Return home, to start elsewhere: a cornered robot cannot attack."""
        return 0.1 * (self._robot.home - q_cmd)

    def _at_full_speed(self, dq: Array) -> Array:
        return dq / max(float(np.max(np.abs(dq) / self._fastest)), 1e-12)


CLEARANCE_TOLERANCE_M = 1e-4
"""Tolerance of the stop distance: the telegram's decimals and the drives' older setpoints."""

_DRIFT = 0.01
"""Probability that a robot skips a cycle."""

_MOST_CYCLES_LATE = 8


@dataclass(frozen=True)
class _Impairment:
    """Probabilities that a wire loses or doubles a message, and that it is slow in a cycle."""

    loss: float = 0.0
    duplicate: float = 0.0
    slow: float = 0.0

    def drawn(self, random: np.random.Generator, cycle_s: float) -> LinkFaults:
        """The faults of one cycle; messages that are late overtake one another."""
        jitter_s = _MOST_CYCLES_LATE * cycle_s * float(random.random() < self.slow)
        return LinkFaults(drop=self.loss, duplicate=self.duplicate, jitter_s=jitter_s)


_MILD = _Impairment(loss=0.02, duplicate=0.02, slow=0.03)
_SEVERE = _Impairment(loss=0.3, duplicate=0.2, slow=0.4)
_CUT = _Impairment(loss=1.0)


class AttackViolation(BaseModel, frozen=True):
    """A cycle in which an invariant did not hold."""

    cycle: int
    what: str
    value: float
    bound: float


class AttackReport(BaseModel, frozen=True):
    """Outcome of an attack."""

    experiment: str = "attack"
    seed: int
    cycles: int
    decided: int
    cycle_s: float
    violations: tuple[AttackViolation, ...]
    limits: LimitCounts
    clearance_min_m: float
    self_clearance_min_m: float
    gate: GateCounts
    reasons: dict[str, int]
    tactics: dict[str, int]
    resets: int
    braked_cycles: int


@dataclass
class _Record:
    setpoints: dict[str, list[Array]] = field(default_factory=dict)
    violations: list[AttackViolation] = field(default_factory=list)
    least: float = np.inf
    least_own: float = np.inf
    tactics: Counter[str] = field(default_factory=Counter)
    resets: int = 0


def run(
    cell_name: str | Path = "lab",
    *,
    seed: int = 0,
    duration_s: float = 60.0,
    on_cycle: Callable[[int, int], None] | None = None,
) -> AttackReport:
    """Attack the gate in virtual time.

    Args:
        cell_name: cell whose robots are all driven over RSI.
        seed: seed of the adversaries, the links and the clocks.
        duration_s: virtual length.
        on_cycle: called with the number of cycles done and the number of all.
    """
    random = np.random.default_rng(seed)
    stack = VirtualCell(cell_name)
    cycle_s = stack.cell.description.cycle_s
    oracle = ClearanceOracle(stack.cell)
    adversaries = {name: Adversary(robot, cycle_s, random) for name, robot in stack.cell.robots.items()}
    stack.run_until_ready()
    for name in stack.arms:
        stack.acquire(name, f"adversary-{name}")
    record = _Record({name: [] for name in stack.arms})
    wires = _plugged(stack, random)
    cycles = round(duration_s / cycle_s)
    for cycle in range(cycles):
        if cycle % 200 == 0:
            impairments = [_impairments(random) for _ in stack.arms]
        for wire, impairment in zip(wires, chain(*impairments), strict=True):
            wire.link.faults = impairment.drawn(random, cycle_s)
        # clocks drift: now one robot waits for the other, now the other
        cycled = [name for name in stack.arms if random.random() >= _DRIFT]
        stack.cycle(cycled)
        _ask(stack, adversaries, record, random)
        _judge(stack, oracle, record, cycle, cycled)
        if on_cycle is not None:
            on_cycle(cycle + 1, cycles)
    return _report(stack, record, seed, cycles)


def _plugged(stack: VirtualCell, random: np.random.Generator) -> list[MessageWire]:
    """Of each robot the wires of its admissions, of the gate's heartbeats and of its states to the gate."""
    wires = []
    for name in stack.arms:
        for kind, to in (
            (Admission, Process.ROBOT_SERVER),
            (Supervision, Process.ROBOT_SERVER),
            (ServerState, Process.SIM),
        ):
            wires.append(MessageWire(int(random.integers(2**32))))
            stack.plug(Link.SIM_SERVER, to, wires[-1], [name], kind)
    return wires


def _impairments(random: np.random.Generator) -> tuple[_Impairment, ...]:
    """Mostly mild wires, sometimes severe ones, and now and then one that is cut, so that a robot is dead."""
    kinds = random.choice(3, size=3, p=[0.7, 0.2, 0.1])
    of_admissions, *others = ((_MILD, _SEVERE, _CUT)[kind] for kind in kinds)
    return of_admissions, *(_SEVERE if one is _CUT else one for one in others)


def _ask(
    stack: VirtualCell, adversaries: dict[str, Adversary], record: _Record, random: np.random.Generator
) -> None:
    tools = {
        name: robot.forward(np.array(stack.states[name].q_cmd))[:3, 3]
        for name, robot in stack.cell.robots.items()
    }
    leases = stack.status().robots
    for name, adversary in adversaries.items():
        others = [tool for other, tool in tools.items() if other != name]
        target = others[0] if others else np.zeros(3)
        if stack.states[name].phase is Phase.HELD:
            stack.reset(name)
            record.resets += 1
        if leases[name].lease.holder is None:
            stack.acquire(name, f"adversary-{name}")
        dq = adversary.increment(np.array(stack.states[name].q_cmd), target)
        record.tactics[adversary.tactic_name] += 1
        for _ in range(1 + int(random.random() < 0.05)):
            stack.ask(name, dq)


def _judge(
    stack: VirtualCell, oracle: ClearanceOracle, record: _Record, cycle: int, cycled: list[str]
) -> None:
    gate = stack.cell.description.gate
    actual = {}
    for name, arm in stack.krc_arms.items():
        actual[name] = arm.krc.sample.q
        if name in cycled:
            record.setpoints[name].append(arm.krc.sample.q_setpoint)
    near, own = oracle.between_robots_and_structure(actual), oracle.of_one_robot(actual)
    record.least, record.least_own = min(record.least, near.distance_m), min(record.least_own, own.distance_m)
    for what, found, bound in (
        ("clearance", near, gate.stop_distance_m),
        ("self clearance", own, gate.self_stop_distance_m),
    ):
        if found.distance_m < bound - CLEARANCE_TOLERANCE_M:
            record.violations.append(
                AttackViolation(
                    cycle=cycle, what=f"{what} {' '.join(found.pair)}", value=found.distance_m, bound=bound
                )
            )


def _report(stack: VirtualCell, record: _Record, seed: int, cycles: int) -> AttackReport:
    cycle_s = stack.cell.description.cycle_s
    limits = LimitCounts.sum(
        limit_violations(stack.cell.robots[name], np.array(rows), cycle_s)
        for name, rows in record.setpoints.items()
    )
    counters = stack.sim.counters
    gate = GateCounts.of(counters)
    return AttackReport(
        seed=seed,
        cycles=cycles,
        decided=gate.admitted + gate.scaled + gate.held,
        cycle_s=cycle_s,
        violations=tuple(record.violations[:20]),
        limits=limits,
        clearance_min_m=record.least,
        self_clearance_min_m=record.least_own,
        gate=gate,
        reasons={k.removeprefix("reason_"): v for k, v in counters.items() if k.startswith("reason_")},
        tactics=dict(record.tactics),
        resets=record.resets,
        braked_cycles=sum(arm.server.counters["braked_cycles"] for arm in stack.arms.values()),
    )
