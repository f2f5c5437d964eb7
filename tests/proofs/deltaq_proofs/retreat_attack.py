"""Attacks on retreat: thousands of violations, each with increments that try to come nearer.

`python -m deltaq_proofs.retreat_attack` draws situations (`retreat_situations`), asks the gate for increments
outwards, inwards, sideways and at random, drives what it admits and measures every pair of bodies at every setpoint and
between them. No pair may come nearer than it was, or than the stop distance if it was further, except by the motion of
another robot that is still braking.
"""

import argparse
import json
from collections import Counter
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from rich.console import Console
from rich.progress import track

from deltaq_cell.cell_model import CellModel
from deltaq_cell.compiled_proximity import CompiledProximity
from deltaq_deploy.launch.program import run_program
from deltaq_proofs.retreat_situations import Situation, situation
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import Admission, Plan, ServerState
from deltaq_protocol.messages import Outcome, Phase
from deltaq_services.sim.gate import Contacts, Gate
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.retreat import Violations
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import drives_of
from deltaq_testing.oracle import ClearanceOracle


class Stage:
    """Where one situation is played.

    Args:
        cell: its cell.
        proximity: of that cell.
        drawn: the situation.

    Attributes:
        longest_brake: cycles after which every robot that is asked for nothing more stands.
    """

    def __init__(self, cell: CellModel, proximity: CompiledProximity, drawn: Situation) -> None:
        description = cell.description
        cycle_s = description.cycle_s
        self._limits = {name: Limits.of(robot, cycle_s) for name, robot in description.robots.items()}
        self._gate = Gate(
            proximity, self._limits, description.gate, Contacts(proximity, description.contacts), Violations()
        )
        drives = {
            name: drives_of(robot, description.gate, cycle_s) for name, robot in description.robots.items()
        }
        self._trackers = {
            name: Tracker(name, robot, drives[name], cycle_s) for name, robot in description.robots.items()
        }
        self._plans: dict[str, Plan] = {}
        lag = 1 + max(each.lag for each in drives.values())
        self._cycle, self._sequence = lag, 0
        for name, tracker in self._trackers.items():
            dq = drawn.dq[name]
            self._plans[name] = self._plan(name, dq, 0 if dq.any() else 1)
            for cycle in range(1, lag + 1):
                tracker.observe(self._state(name, cycle, drawn.q[name] - (lag - cycle) * dq, dq))
        self.longest_brake = lag + max(
            self._plan(name, limits.max_dq, 0).brake_cycles for name, limits in self._limits.items()
        )

    def q_cmd(self) -> dict[str, Array]:
        """Per robot its setpoint (n,) [rad or m]."""
        return {name: tracker.q_cmd for name, tracker in self._trackers.items()}

    def fastest(self, robot: str) -> Array:
        """(n,) increment of each joint at its velocity limit [rad or m]."""
        return self._limits[robot].max_dq

    def ask(self, robot: str, dq: Array) -> Outcome:
        """Ask for an increment (n,) [rad or m]; what is admitted is sent in the next cycle."""
        tracker = self._trackers[robot]
        others = [other for name, other in self._trackers.items() if name != robot]
        decision = self._gate.decide(tracker, others, dq)
        state = tracker.state
        assert state is not None  # every robot has been heard
        if decision.outcome is not Outcome.HELD:
            self._sequence += 1
            ahead = tracker.ahead
            admission = Admission(
                robot=robot,
                epoch=1,
                sequence=self._sequence,
                cycle=tracker.decided_after,
                follows_sequence=ahead.sequence,
                follows_q_cmd=tuple(ahead.q_cmd.tolist()),
                follows_dq=tuple(ahead.dq.tolist()),
                dq=tuple(decision.dq.tolist()),
                brake_cycles=decision.brake_cycles,
            )
            tracker.admitted(admission)
        return decision.outcome

    def cycle(self) -> None:
        """Send every robot its admitted increment, or the next step of its brake."""
        self._cycle += 1
        for name, tracker in self._trackers.items():
            plan = self._plans[name]
            if tracker.in_flight:
                admitted = tracker.in_flight[0]
                plan = Plan(dq=admitted.dq, brake_cycles=admitted.brake_cycles, step=0)
            else:
                plan = plan.model_copy(update={"step": plan.step + 1})
            dq = brake_increment(np.array(plan.dq), plan.brake_cycles, plan.step)
            self._plans[name] = (
                plan if plan.step < plan.brake_cycles else self._plan(name, np.zeros_like(dq), 1)
            )
            tracker.observe(self._state(name, self._cycle, tracker.q_cmd + dq, dq))

    def _plan(self, robot: str, dq: Array, step: int) -> Plan:
        return Plan(dq=tuple(dq.tolist()), brake_cycles=self._limits[robot].brake_cycles(dq), step=step)

    def _state(self, robot: str, cycle: int, q: Array, dq: Array) -> ServerState:
        here = tuple(q.tolist())
        return ServerState(
            robot=robot,
            process=1,
            cycle=cycle,
            ipoc=cycle,
            time_s=float(cycle),
            q=here,
            q_cmd=here,
            dq=tuple(dq.tolist()),
            plan=self._plans[robot],
            epoch=1,
            sequence=self._sequence,
            phase=Phase.ENGAGED,
        )


TOLERANCE_M = 1e-5
"""How much nearer a pair may come in all."""

CYCLES = 24
"""Increments that are requested in each situation."""

ASK = ("outwards", "inwards", "along", "creep", "noise", "mixed")
"""Kinds of increments; mixed draws one of the others in each cycle."""
_CREEP = 1e-6
"""Least fraction of the velocity limit that a creep requests; each of its increments is drawn separately."""


@dataclass(frozen=True)
class RetreatOutcome:
    """Result of one situation.

    Attributes:
        seed: of the situation.
        ask: kind of the requested increments.
        room_m: clearance beyond the stop distance at the beginning.
        moving: whether another robot moved.
        nearer_m: most by which a pair came nearer than it may; negative if none did.
        gained_m: by how much the least room of all pairs grew.
        decisions: of the gate, by outcome.
    """

    seed: int
    ask: str
    room_m: float
    moving: bool
    nearer_m: float
    gained_m: float
    decisions: dict[str, int]


class RetreatAttack:
    """One cell, and everything that can be used again for the next situation."""

    def __init__(self, cell_name: str = "lab") -> None:
        self._cell = CellModel.load(cell_name)
        self._proximity = CompiledProximity(self._cell)
        self._oracle = ClearanceOracle(self._cell)
        self._stops_m = self._oracle.stop_distances_m

    def run(self, seed: int, ask: str | None = None) -> RetreatOutcome:
        """Play one situation.

        Args:
            seed: of the situation.
            ask: which increments to ask for, one of `ASK`; drawn if none is given.
        """
        random = np.random.default_rng(seed)
        drawn = situation(self._cell, self._oracle, random)
        drawn_ask = ASK[int(random.integers(len(ASK)))]
        ask = ask or drawn_ask
        stage = Stage(self._cell, self._proximity, drawn)
        others = [name for name in self._cell.robots if name != drawn.robot]
        driven = [drawn.robot, *others] if random.uniform() < 0.3 and not _moves(drawn) else [drawn.robot]
        began = self._room(drawn.q)
        keeps_m = self._oracle.distances_m(drawn.q, self._stops_m).clip(max=self._stops_m)
        nearer, outcomes = -np.inf, Counter[str]()
        for cycle in range(CYCLES + stage.longest_brake):
            before = stage.q_cmd()
            if cycle < CYCLES:
                for name in driven:
                    outcomes[stage.ask(name, self._increment(stage, name, ask, random))] += 1
            stage.cycle()
            after = stage.q_cmd()
            if all((before[name] == after[name]).all() for name in before):
                if cycle >= CYCLES:
                    break
                continue
            for share in (0.5, 1.0):
                now = {name: before[name] + share * (after[name] - before[name]) for name in before}
                if _moves(drawn):
                    # motion of a robot that nobody drives does not count against the driven one
                    undriven = {name: now[name] if name not in driven else drawn.q[name] for name in now}
                    keeps_m = np.minimum(keeps_m, self._oracle.distances_m(undriven, keeps_m))
                nearer = max(nearer, -self._oracle.least_room_m(now, keeps_m))
        gained = self._room(stage.q_cmd()) - began
        return RetreatOutcome(seed, ask, drawn.room_m, _moves(drawn), nearer, gained, dict(outcomes))

    def _room(self, q: dict[str, Array]) -> float:
        """Least distance of all pairs beyond their stop distances [m]."""
        return self._oracle.least_room_m(q, self._stops_m)

    def _increment(self, stage: Stage, name: str, ask: str, random: np.random.Generator) -> Array:
        q, fastest = stage.q_cmd(), stage.fastest(name)
        noise = random.uniform(-1, 1, fastest.size) * fastest
        if ask == "mixed":
            ask = ASK[int(random.integers(len(ASK) - 1))]
        if ask == "noise":
            return noise * random.uniform(0, 1)
        steepest = self._steepest(q, name)
        if ask == "along":
            flat: Array = noise - steepest * (noise @ steepest) / max(float(steepest @ steepest), 1e-12)
            return flat * random.uniform(0, 0.3)
        outwards: Array = steepest / max(float(np.max(np.abs(steepest) / fastest)), 1e-12)
        if ask == "creep":
            return -outwards * _CREEP * float(10.0 ** random.uniform(0, 4))
        if ask == "outwards":
            # a joint at its limit would hold all others
            robot = self._cell.robots[name]
            blocked = np.where(outwards > 0, q[name] >= robot.upper, q[name] <= robot.lower)
            outwards[blocked] = 0.0
        share = float(random.uniform(0.01, 1.0))
        return outwards * (share if ask == "outwards" else -share)

    def _steepest(self, q: dict[str, Array], name: str) -> Array:
        """(n,) change of the least room per unit of each joint [m/rad or m/m]."""
        steps = 1e-4 * np.eye(q[name].size)
        here = self._room(q)
        there = [self._room(q | {name: q[name] + step}) for step in steps]
        steepest: Array = (np.array(there) - here) / 1e-4
        return steepest


def _moves(drawn: Situation) -> bool:
    return any(dq.any() for dq in drawn.dq.values())


_attack: RetreatAttack | None = None


def _prepare(cell_name: str) -> None:
    global _attack
    _attack = RetreatAttack(cell_name)


def _run(seed: int) -> RetreatOutcome:
    assert _attack is not None  # every process of the pool has prepared it
    return _attack.run(seed)


def main() -> None:
    """Play situations and print the results as one JSON object."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_proofs.retreat_attack",
        description="Retreat under attack, judged by an independent oracle.",
    )
    parser.add_argument(
        "--cell", default="lab", help="cell with RSI or kinematic robots (default: %(default)s)"
    )
    parser.add_argument("--situations", type=int, default=10_000, help="how many (default: %(default)s)")
    parser.add_argument(
        "--seed", type=int, default=0, help="of the first; each has its own (default: %(default)s)"
    )
    parser.add_argument("--processes", type=int, default=1, help="at a time (default: %(default)s)")
    options = parser.parse_args()
    for name in ("situations", "processes"):
        if (count := getattr(options, name)) < 1:
            parser.error(f"--{name} {count}: at least 1")
    seeds = range(options.seed, options.seed + options.situations)
    with get_context("spawn").Pool(options.processes, _prepare, (options.cell,)) as pool:
        played = pool.imap_unordered(_run, seeds, chunksize=8)
        outcomes = list(track(played, "situations", len(seeds), console=Console(stderr=True)))
    print(json.dumps(summary(outcomes)))


def summary(outcomes: list[RetreatOutcome]) -> dict[str, object]:
    """Figures of many situations: how near, how often it got out, the worst seed, and those that stayed in."""
    worst = max(outcomes, key=lambda item: item.nearer_m)
    inside = [
        item for item in outcomes if item.room_m < -TOLERANCE_M and item.ask == "outwards" and not item.moving
    ]
    decisions: Counter[str] = Counter()
    for item in outcomes:
        decisions.update(item.decisions)
    return {
        "situations": len(outcomes),
        "moving": sum(item.moving for item in outcomes),
        "decisions": dict(decisions),
        "nearer_than_allowed": sum(item.nearer_m > TOLERANCE_M for item in outcomes),
        "nearer_m": {"worst": worst.nearer_m, "seed": worst.seed},
        "outwards": {
            "situations": len(inside),
            "let_out": sum(item.gained_m > TOLERANCE_M for item in inside),
            "left_in": sorted(item.seed for item in inside if item.gained_m <= TOLERANCE_M),
        },
    }


if __name__ == "__main__":
    run_program(main, "deltaq_proofs.retreat_attack")
