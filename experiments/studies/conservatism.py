"""How conservative the gate is: of what it scaled or held for clearance, how much would really have come too near?

`python -m studies.conservatism` drives both robots with adversaries over perfect links, once for each seed.
Of a sample of the decisions that clearance limited, an oracle of dense samples (an independent implementation) tells
how much room the tube of the blend that velocity, acceleration and position would have allowed really leaves beyond the
stop distance. Where that is less than nothing, the decision is confirmed; elsewhere it is the gate's excess. Beside it
stands how far the gate's bound of the pair that it names is below that pair's distance in the samples.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_deploy.launch.program import run_program
from deltaq_protocol.arrays import Array
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.core import Decider
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.limits import Limits
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import Windows
from deltaq_testing.attack import Adversary
from deltaq_testing.oracle import ClearanceOracle
from deltaq_testing.virtual_cell.cell import VirtualCell

QUANTILES = {"p50": 50.0, "p90": 90.0, "p95": 95.0, "p99": 99.0, "most": 100.0}


@dataclass(frozen=True)
class ConservatismFigures:
    """Decisions that clearance limited, and the oracle's judgement of them.

    Attributes:
        decisions: all.
        bound_by_clearance: of these.
        rooms_m: of each that the oracle was asked about: the least room beyond the stop distance in its samples [m].
        slacks_m: of the same: the distance of the named pair in the samples less the gate's bound of it [m].
    """

    decisions: int
    bound_by_clearance: int
    rooms_m: tuple[float, ...]
    slacks_m: tuple[float, ...] = ()

    @property
    def confirmed(self) -> int:
        """How many of the checked decisions the oracle would have refused too."""
        return sum(room < 0.0 for room in self.rooms_m)

    @property
    def confirmed_share(self) -> float | None:
        """Their fraction; None if none was checked."""
        return self.confirmed / len(self.rooms_m) if self.rooms_m else None

    @property
    def excess_mm(self) -> dict[str, float]:
        """Room that a refused motion had, as quantiles over all that were checked; none for a confirmed one [mm]."""
        if not self.rooms_m:
            return {}
        excess = 1e3 * np.maximum(self.rooms_m, 0.0)
        return {name: float(np.percentile(excess, percent)) for name, percent in QUANTILES.items()}

    @property
    def slack_mm(self) -> dict[str, float]:
        """How far the gate's bound was below the distance in the samples, as quantiles [mm].

        A bound is that of the piece at which the certificate ended, which may be shorter than the tube. Then it can
        be more than the least in the samples, and the figure is less than nothing.
        """
        return {
            name: 1e3 * float(np.percentile(self.slacks_m, percent))
            for name, percent in QUANTILES.items()
            if self.slacks_m
        }

    def __add__(self, other: ConservatismFigures) -> ConservatismFigures:
        """Of two runs together."""
        return ConservatismFigures(
            self.decisions + other.decisions,
            self.bound_by_clearance + other.bound_by_clearance,
            self.rooms_m + other.rooms_m,
            self.slacks_m + other.slacks_m,
        )

    def told(self) -> dict[str, object]:
        """For the user."""
        return {
            "decisions": self.decisions,
            "bound_by_clearance": self.bound_by_clearance,
            "asked": len(self.rooms_m),
            "confirmed": self.confirmed,
            "confirmed_share": self.confirmed_share,
            "excess_mm": self.excess_mm,
            "slack_mm": self.slack_mm,
        }


class Auditor:
    """Wraps a gate, and asks the oracle about a sample of the decisions that clearance limited.

    Args:
        gate: makes the decisions.
        cell: its cell.
        every: one decision in this many is checked.
        samples: configurations of each tube that are measured.
    """

    def __init__(self, gate: Decider, cell: CellModel, every: int, samples: int) -> None:
        self.decisions = self.bound = 0
        self.rooms_m: list[float] = []
        self.slacks_m: list[float] = []
        self._gate = gate
        self._oracle = ClearanceOracle(cell)
        self._stop = cell.description.gate.stop_distance_m
        self._self_stop = cell.description.gate.self_stop_distance_m
        cycle_s = cell.description.cycle_s
        self._limits = {name: Limits.of(robot, cycle_s) for name, robot in cell.description.robots.items()}
        self._every, self._samples = every, samples

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        """Decide one request."""
        decision = self._gate.decide(robot, others, request)
        self.decisions += 1
        if any(reason.code is ReasonCode.CLEARANCE for reason in decision.reasons):
            self.bound += 1
            if self.bound % self._every == 0:
                assert decision.binding is not None  # the pair that clearance was refused for
                nearest = decision.binding.nearest
                room_m, distance_m = self._sampled(robot, others, request, nearest.pair)
                self.rooms_m.append(room_m)
                self.slacks_m.append(distance_m - nearest.swept_m)
        return decision

    def _sampled(
        self, robot: Tracker, others: Sequence[Tracker], request: Array, pair: tuple[str, str]
    ) -> tuple[float, float]:
        """What dense samples show of what the limits alone would allow.

        Returns:
            The least room of all pairs beyond their stop distance [m], and the least distance of `pair` [m].
        """
        limits, brake = self._limits[robot.name], robot.brake()
        scale, _ = limits.scale(brake, request, robot.ahead.dq, robot.ahead.q_cmd)
        dq = brake + scale * (request - brake)
        mine = self._along(robot.tube(robot.course(dq, limits.brake_cycles(dq))))
        theirs = [(other.name, self._along(tube)) for other in others for tube in other.tubes()]
        room_m = distance_m = np.inf
        for q in mine:
            where = {robot.name: q}
            alone = self._oracle.of_one_robot(where | {name: rows[0] for name, rows in theirs})
            room_m = min(room_m, alone.distance_m - self._self_stop)
            for name, rows in theirs:
                for q_other in rows[:: max(1, len(rows) // 8)]:
                    both = where | {name: q_other}
                    near = self._oracle.between_robots_and_structure(both)
                    room_m = min(room_m, near.distance_m - self._stop)
                    distance_m = min(distance_m, self._oracle.of_pair(pair, both))
        return room_m, distance_m

    def _along(self, tube: Windows) -> Array:
        """(samples, n) configurations along the setpoints of a tube, the end included."""
        points = tube.points[max(0, tube.first - tube.drives.lag) :]
        places = np.linspace(0, len(points) - 1, self._samples)
        return np.array([np.interp(places, np.arange(len(points)), column) for column in points.T]).T


def run(
    cell_name: str = "lab", seed: int = 0, cycles: int = 1500, every: int = 10, samples: int = 60
) -> ConservatismFigures:
    """Measure; arguments as for `Auditor`, `cycles` of both robots."""
    random = np.random.default_rng(seed)
    stack = VirtualCell(cell_name)
    auditor = Auditor(stack.sim.gate, stack.cell, every, samples)
    stack.sim.gate = auditor
    cycle_s = stack.cell.description.cycle_s
    adversaries = {name: Adversary(robot, cycle_s, random) for name, robot in stack.cell.robots.items()}
    stack.run_until_ready()
    for name in stack.arms:
        stack.acquire(name, "adversary")
    for _ in range(cycles):
        stack.cycle()
        q_cmd = {name: np.array(state.q_cmd) for name, state in stack.states.items()}
        tools = {name: robot.forward(q_cmd[name])[:3, 3] for name, robot in stack.cell.robots.items()}
        for name, adversary in adversaries.items():
            target = next(tool for other, tool in tools.items() if other != name)
            stack.ask(name, adversary.increment(q_cmd[name], target))
    return ConservatismFigures(
        auditor.decisions, auditor.bound, tuple(auditor.rooms_m), tuple(auditor.slacks_m)
    )


def main() -> None:
    """Print the figures, one JSON object a line: each seed's, then those of all together."""
    parser = argparse.ArgumentParser(
        description="How conservative the gate is, by an oracle of dense samples."
    )
    parser.add_argument("--cell", default="lab", help="cell with two robots (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="one seed is one run (default: %(default)s)")
    parser.add_argument(
        "--seeds", type=int, default=1, help="how many, from that one on (default: %(default)s)"
    )
    parser.add_argument(
        "--cycles", type=int, default=1500, help="cycles of both robots (default: %(default)s)"
    )
    parser.add_argument("--every", type=int, default=10, help="ask about one decision in so many")
    parser.add_argument("--samples", type=int, default=60, help="samples of each tube (default: %(default)s)")
    options = parser.parse_args()
    for name in ("seeds", "cycles", "every", "samples"):
        if (count := getattr(options, name)) < 1:
            parser.error(f"--{name} {count}: at least 1")
    found = []
    for seed in range(options.seed, options.seed + options.seeds):
        found.append(run(options.cell, seed, options.cycles, options.every, options.samples))
        print(json.dumps({"seed": seed} | found[-1].told()), flush=True)
    if len(found) > 1:
        print(json.dumps({"seeds": len(found)} | reduce(add, found).told()))


if __name__ == "__main__":
    run_program(main, "studies.conservatism")
