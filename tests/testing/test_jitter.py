"""Answers that take a little longer now and then, in virtual time: what an increment in hand makes of them."""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import pytest
from delayed_wire import DelayedWire
from leasing_client import LeasingClient

from deltaq_protocol.guarded import Admission, Request
from deltaq_protocol.messages import Message, Outcome, RobotState, Verdict
from deltaq_services.sim.inbox import Inbox
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Link, Process


class JitteryClient(LeasingClient):
    """Answers each state of a robot with the same increment, and keeps the verdicts.

    Args:
        say: sends to the HLI.
        robot: that it drives.
        dq: the increment [rad or m].

    Attributes:
        verdicts: all that came.
        answered: by number of an increment, the cycle of the state that it answers.
    """

    def __init__(self, say: Callable[[Message], None], robot: str, dq: tuple[float, ...]) -> None:
        super().__init__(say, robot)
        self.verdicts: list[Verdict] = []
        self.answered: dict[int, int] = {}
        self._dq = dq

    def take_verdict(self, verdict: Verdict) -> None:
        """Keep it."""
        self.verdicts.append(verdict)

    def take_state(self, state: RobotState) -> None:
        """Answer it."""
        self._seq += 1
        self.answered[self._seq] = state.cycle
        self.ask(state.cycle, self._dq)


pytestmark = pytest.mark.long

SEEDS = (0, 1, 3)
CYCLES = 300
DQ = (1e-6, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Jitter:
    """How long a controller takes, a lognormal distribution, and the gate after it, a uniform one [s]."""

    median_s: float
    sigma: float
    gate_least_s: float
    gate_more_s: float


SLOW_CONTROLLER = Jitter(median_s=8e-3, sigma=0.12, gate_least_s=1.5e-3, gate_more_s=0.5e-3)
SLOW_GATE = Jitter(median_s=5e-3, sigma=0.3, gate_least_s=2e-3, gate_more_s=4e-3)


class KeepsNothing(Inbox):
    """The gate without an increment in hand: what was missed is lost."""

    def cycle_passed(self, cycle: int, missed: bool) -> Request | None:
        return super().cycle_passed(cycle, missed=False)


@dataclass
class Run:
    """How one robot fared, and what its controller was told.

    Attributes:
        braked: cycles without an admission.
        longest: most of them in a row.
        setpoint_cycles: by sequence number, the cycle that each increment went into as the last verdict on it told.
        fresh: cycles in which an admission was taken.
    """

    braked: int
    longest: int
    setpoint_cycles: dict[int, int]
    fresh: set[int]


@pytest.fixture(scope="module")
def lab():
    return LoadedCell.load("lab")


def run(lab, seed, jitter, keeps=True):
    cell = VirtualCell(lab)
    cell.run_until_ready()
    of_client, of_gate = random.Random(seed), random.Random(seed + 1000)
    up = DelayedWire(lambda: jitter.median_s * math.exp(jitter.sigma * of_client.gauss(0, 1)))
    client = cell.connect(partial(JitteryClient, robot="fr", dq=DQ), up=up).core
    client.acquire()
    while client.token is None:
        cell.cycle()
    to_server = DelayedWire(lambda: jitter.gate_least_s + jitter.gate_more_s * of_gate.random())
    cell.plug(Link.SIM_SERVER, Process.ROBOT_SERVER, to_server, ["fr"], Admission)
    if not keeps:
        cell.sim.robots["fr"].inbox = KeepsNothing(joints=6, max_age_cycles=10)
    client.answers = True
    for _ in range(5):  # from here on every cycle has an answer under way
        cell.cycle()
    server, braked, in_a_row, longest, fresh = cell.arms["fr"].server, 0, 0, 0, set()
    for _ in range(CYCLES):
        taken = server.counters["admissions"]
        cell.cycle()
        if server.counters["admissions"] > taken:
            fresh.add(server.state.cycle)
            in_a_row = 0
        else:
            braked, in_a_row = braked + 1, in_a_row + 1
        longest = max(longest, in_a_row)
    told = {
        v.seq: v.setpoint_cycle for v in client.verdicts if v.outcome in (Outcome.ADMITTED, Outcome.SCALED)
    }
    return Run(braked, longest, told, fresh)


@pytest.mark.nightly
@pytest.mark.parametrize("jitter", [SLOW_CONTROLLER, SLOW_GATE])
def test_late_answers_cost_few_cycles_if_they_are_carried_over(lab, jitter):
    with_hand = [run(lab, seed, jitter) for seed in SEEDS]
    without = [run(lab, seed, jitter, keeps=False) for seed in SEEDS]
    assert sum(one.braked for one in without) >= 15  # else there was no jitter
    assert all(one.braked <= 1 for one in with_hand), [one.braked for one in with_hand]
    assert all(one.longest <= 1 for one in with_hand)
    assert all(kept.braked <= lost.braked for kept, lost in zip(with_hand, without, strict=True))


def test_a_client_learns_the_cycle_of_each_of_its_increments(lab):
    seen = run(lab, 3, SLOW_GATE)
    first, last = min(seen.fresh), max(seen.fresh)
    told = [cycle for cycle in seen.setpoint_cycles.values() if first <= cycle <= last]
    assert len(told) == len(set(told))
    assert set(told) == seen.fresh
