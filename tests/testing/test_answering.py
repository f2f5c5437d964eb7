"""A controller that answers each state as it comes and waits for no verdict, in virtual time, with the real cores."""

import math
import random
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from delayed_wire import DelayedWire
from leasing_client import LeasingClient

from deltaq_controllers.limits import IncrementLimits
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission
from deltaq_protocol.in_flight import Ahead, InFlight
from deltaq_protocol.messages import Message, Outcome, Phase, RobotState, Verdict
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.clients import Connection
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Link, Process


class AnsweringClient(LeasingClient):
    """Answers the states of a robot without waiting for verdicts, or with waiting for the one before.

    Args:
        say: sends to the HLI.
        robot: that it drives.
        increment: makes an increment (n,) [rad or m] from what it is added to.
        waits: for the verdict on each increment before it answers another state, for up to four cycles.

    Attributes:
        hears: is asked of each verdict whether it comes to the controller.
        expected: by cycle, the setpoint (n,) that it reckoned with last [rad or m].
        counted: first verdicts that came, by outcome, and `given up`.
    """

    def __init__(
        self,
        say: Callable[[Message], None],
        robot: str,
        increment: Callable[[Ahead], Array],
        waits: bool = False,
    ) -> None:
        super().__init__(say, robot)
        self.hears: Callable[[Verdict], bool] = lambda _: True
        self.in_flight = InFlight()
        self.expected: dict[int, Array] = {}
        self.counted: dict[str, int] = {}
        self._increment, self._waits = increment, waits
        self._awaited: tuple[int, int] | None = None
        self._unanswered: RobotState | None = None

    def take_verdict(self, verdict: Verdict) -> None:
        if self.hears(verdict):
            self.tell(verdict)

    def tell(self, verdict: Verdict) -> None:
        """A verdict comes to the controller."""
        if self._awaited is not None and self._awaited[0] == verdict.seq:
            self._awaited = None
        if self.in_flight.take(verdict):
            self._count(verdict.outcome.value)
        if self._waits and self._unanswered is not None:
            self.take_state(self._unanswered)

    def take_state(self, state: RobotState) -> None:
        self._unanswered = state
        if self._waits and self._awaited is not None and state.cycle < self._awaited[1] + 4:
            return
        self._unanswered = None
        cycles = self.in_flight.cycles_to_answer(state)
        for cycle in cycles[-1:] if self._waits else cycles:
            ahead = self.in_flight.ahead(state)
            self.expected[ahead.cycle] = ahead.q_cmd
            dq = np.array(self._increment(ahead))
            self._seq += 1
            # before it is sent: on a perfect wire the verdict comes while it is
            self.in_flight.sent(self._seq, dq, cycle)
            self._awaited = self._seq, state.cycle
            self.ask(cycle, tuple(dq.tolist()))
        for _ in range(self.in_flight.take_given_up()):
            self._count("given up")

    def _count(self, what: str) -> None:
        self.counted[what] = self.counted.get(what, 0) + 1


pytestmark = [pytest.mark.long, pytest.mark.by_day(1)]

CYCLES = 150
SLOWLY = 1e-3
"""Largest increment that is asked for, well below what the limits allow [rad]."""
GATE_S = 2e-3
"""From the gate to the Robot Server."""


class Walk:
    """Asks for increments that change a little from one to the next, so that any two differ."""

    def __init__(self, seed: int, most: float = SLOWLY) -> None:
        self._drawn, self._most = np.random.default_rng(seed), most
        self._dq = np.zeros(6)

    def __call__(self, _: Ahead) -> Array:
        self._dq = np.clip(self._dq + 1e-4 * self._drawn.uniform(-1, 1, 6), -self._most, self._most)
        return self._dq


class Driven:
    """FR in virtual time, driven by an `AnsweringClient`.

    Attributes:
        sent: by cycle, the setpoint (6,) that the Robot Server sent [rad].
        fresh: cycles in which it took an admission.
    """

    def __init__(
        self,
        loaded: LoadedCell,
        increment: Callable[[Ahead], Array],
        up_s: Callable[[], float],
        waits: bool = False,
    ) -> None:
        self.cell = VirtualCell(loaded)
        self.cell.run_until_ready()
        begin = partial(AnsweringClient, robot="fr", increment=increment, waits=waits)
        self.connection: Connection = self.cell.connect(begin, up=DelayedWire(up_s))
        self.cell.plug(Link.SIM_SERVER, Process.ROBOT_SERVER, DelayedWire(lambda: GATE_S), ["fr"], Admission)
        self.sent: dict[int, Array] = {}
        self.fresh: set[int] = set()
        self.acquire()
        self.client.answers = True

    @property
    def client(self) -> AnsweringClient:
        client = self.connection.core
        assert isinstance(client, AnsweringClient)
        return client

    def acquire(self) -> None:
        self.client.acquire()
        for _ in range(10):
            if self.client.token is not None:
                return
            self.run(1)
        raise AssertionError("no lease")

    def run(self, cycles: int) -> None:
        server = self.cell.arms["fr"].server
        for _ in range(cycles):
            taken = server.counters["admissions"]
            self.cell.cycle()
            cycle = server.state.cycle
            self.sent[cycle] = np.array(server.state.q_cmd)
            if server.counters["admissions"] > taken:
                self.fresh.add(cycle)

    def off(self, since: int = 0) -> dict[int, float]:
        """By cycle how far its setpoint was from where the controller reckoned it to be [rad]."""
        return {
            cycle: float(np.abs(self.sent[cycle] - q_cmd).max())
            for cycle, q_cmd in self.client.expected.items()
            if cycle in self.sent and cycle >= since
        }

    @property
    def cycle(self) -> int:
        return self.cell.arms["fr"].server.state.cycle

    @property
    def braked(self) -> int:
        """Cycles without an admission after the first with one."""
        return sum(cycle not in self.fresh for cycle in self.sent if cycle > min(self.fresh))


def jitter(seed: int, median_s: float, sigma: float) -> Callable[[], float]:
    drawn = random.Random(seed)
    return lambda: median_s * math.exp(sigma * drawn.gauss(0, 1))


@pytest.fixture(scope="module", params=[2, 1, 3])
def ahead(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def lab(ahead: int, tmp_path_factory: pytest.TempPathFactory) -> LoadedCell:
    file: Path = tmp_path_factory.mktemp("cell") / "ahead.yaml"
    file.write_text(f"extends: lab.yaml\ncell: ahead\ngate: {{lookahead_cycles: {ahead}}}\n")
    return LoadedCell.load(file)


# --- what goes wrong -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2])
def test_each_increment_counts_once_despite_lost_verdicts(lab: LoadedCell, seed: int) -> None:
    driven, drawn = Driven(lab, Walk(seed), lambda: 5e-3), random.Random(seed)
    driven.client.hears = lambda _: drawn.random() > 0.2
    driven.run(CYCLES)
    off = driven.off()
    assert driven.client.counted["given up"] > 10
    assert len(off) > CYCLES - 10
    assert max(off.values()) < 1e-12, off


def test_reordered_verdicts_are_corrected_by_the_next_state(
    lab: LoadedCell,
) -> None:
    driven, kept = Driven(lab, Walk(3), lambda: 5e-3), deque[Verdict]()

    def swaps(verdict: Verdict) -> bool:
        kept.append(verdict)
        if len(kept) == 2:
            second, first = kept.pop(), kept.pop()
            driven.client.tell(second)
            driven.client.tell(first)
        return False

    driven.client.hears = swaps
    driven.run(CYCLES)
    off = driven.off()
    assert "given up" not in driven.client.counted
    assert max(off.values()) < 1e-12, off


def test_clipped_motion_is_requested_again_once(lab: LoadedCell) -> None:
    """To a place faster than is allowed: the gate clips, and the robot still stops where it should."""
    goal, limits = 0.4, IncrementLimits.of(lab.model.robots["fr"], lab.model.description.cycle_s)

    def to_goal(ahead: Ahead) -> Array:
        left = goal - ahead.q_cmd[0]
        speed = min(2 * limits.max_dq[0], math.sqrt(limits.max_ddq[0] * abs(left)), 0.2 * abs(left))
        return np.array([math.copysign(speed, left), *np.zeros(5)])

    driven = Driven(lab, to_goal, lambda: 13e-3)
    driven.run(CYCLES)
    assert driven.client.counted[Outcome.SCALED.value] > 3
    assert driven.sent[driven.cycle][0] == pytest.approx(goal, abs=1e-4)
    assert max(q[0] for q in driven.sent.values()) < goal + 1e-3
    assert max(driven.off(driven.cycle - 20).values()) < 1e-9


def test_after_a_hold_and_a_reset_earlier_increments_do_not_count(lab: LoadedCell) -> None:
    driven = Driven(lab, Walk(4), lambda: 5e-3)
    driven.run(40)
    driven.cell.stop()
    driven.run(40)  # a reset is refused as long as the drives move
    assert driven.cell.states["fr"].phase is Phase.HELD
    driven.cell.reset("fr")
    driven.run(5)
    assert driven.cell.states["fr"].phase is not Phase.HELD
    reset = driven.cycle
    driven.run(40)
    assert driven.client.counted[Outcome.REFUSED.value] >= 5
    off = driven.off(reset + 1)
    assert len(off) > 30
    assert max(off.values()) < 1e-12, off


def test_after_a_restart_of_the_hli_driving_resumes_with_a_new_lease(lab: LoadedCell) -> None:
    driven = Driven(lab, Walk(5), lambda: 5e-3)
    driven.run(40)
    hli = driven.cell.process(Process.HLI, "")
    hli.kill()
    driven.run(5)
    assert driven.cell.states["fr"].phase is not None
    hli.start()
    driven.run(40)  # it has no lease: each of its increments is refused
    driven.acquire()
    began = driven.cycle
    driven.run(40)
    off = driven.off(began + 3)
    assert len(off) > 30
    assert max(off.values()) < 1e-12, off


def test_a_controller_without_its_lease_counts_no_increment(lab: LoadedCell) -> None:
    driven = Driven(lab, Walk(6), lambda: 5e-3)
    driven.run(30)
    driven.client.token = "of somebody else"
    driven.run(40)
    assert driven.client.counted[Outcome.REFUSED.value] > 20
    still = driven.sent[driven.cycle]
    np.testing.assert_array_equal(driven.client.expected[max(driven.client.expected)], still)


def test_a_stalled_controller_answers_its_missed_states(lab: LoadedCell, ahead: int) -> None:
    driven = Driven(lab, Walk(7), lambda: 3e-3)
    driven.run(20)
    for _ in range(5):
        driven.client.answers = False
        driven.run(ahead - 1)
        driven.client.answers = True
        driven.run(10)
    assert driven.braked == 0
    assert max(driven.off().values()) < 1e-12
    assert driven.cell.arms["fr"].server.counters["admission_unchained"] == 0


# --- what it is for ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_answers_longer_than_a_cycle_are_free_unless_verdicts_are_awaited(lab: LoadedCell, seed: int) -> None:
    waited, answered = (
        Driven(lab, Walk(seed), jitter(seed, 13e-3, 0.1), waits=waits) for waits in (True, False)
    )
    for driven in (waited, answered):
        driven.run(CYCLES)
    assert waited.braked > 8
    assert answered.braked <= 2, answered.braked
    assert max(answered.off().values()) < 1e-12
