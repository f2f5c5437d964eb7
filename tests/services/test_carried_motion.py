"""Increments that come after their turn: their motion goes out all the same, and is told until it has."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.guarded import Plan
from deltaq_protocol.messages import Increment, Playout
from deltaq_services.hli.playout import (
    MOST_CARRIED_CYCLES,
    SPREAD_CYCLES,
    Asked,
    CarriedMotion,
    Fate,
    PlayoutBuffer,
)

MAX_DQ, MAX_DV = np.array([0.01]), np.array([0.001])
MOST_CYCLES = 83
LONG_ENOUGH = MOST_CYCLES + 6 * SPREAD_CYCLES


def new_carried() -> CarriedMotion:
    return CarriedMotion(MAX_DQ, MAX_DV)


@dataclass
class Robot:
    """One joint that does as it is asked within its limits, and brakes where nothing is asked."""

    q_cmd: float = 0.0
    dq: float = 0.0
    plan: Plan = field(default_factory=lambda: Plan(dq=(0.0,), brake_cycles=1, step=1))
    fastest: float = 0.0
    hardest: float = 0.0
    cut: float = 0.0

    def cycle(self, asked: float | None) -> None:
        last, plan = self.dq, np.array(self.plan.dq)
        if asked is None:
            step = self.plan.step + 1
            self.dq = float(brake_increment(plan, self.plan.brake_cycles, step)[0])
            self.plan = self.plan.model_copy(update={"step": step})
        else:
            self.dq = min(max(asked, last - MAX_DV[0], -MAX_DQ[0]), last + MAX_DV[0], MAX_DQ[0])
            self.cut += abs(asked - self.dq)
            cycles = brake_cycles(np.array([self.dq]), MAX_DV)
            self.plan = Plan(dq=(self.dq,), brake_cycles=cycles, step=0)
        self.q_cmd += self.dq
        self.fastest, self.hardest = max(self.fastest, abs(self.dq)), max(self.hardest, abs(self.dq - last))


@dataclass
class Way:
    """A buffer with a robot behind it, and a controller that reckons as clients do."""

    buffer: PlayoutBuffer = field(default_factory=lambda: PlayoutBuffer(MOST_CYCLES, new_carried()))
    robot: Robot = field(default_factory=Robot)
    cycle: int = 0
    told: list[tuple[Playout, float]] = field(default_factory=list)
    fates: dict[int, list[Fate | None]] = field(default_factory=dict)

    def run(self, motion: list[float], ages: list[list[int]]) -> None:
        """Answer a state each cycle by an increment that comes after each of some cycles; then wait."""
        coming: dict[int, list[int]] = {}
        for k, after in enumerate(ages):
            for age in after:
                coming.setdefault(k + age, []).append(k)
        for now in range(len(ages) + LONG_ENOUGH):
            self.cycle = now
            self.buffer.moved(now, self.robot.plan)
            self.told.append((self.buffer.told(), self.robot.q_cmd))
            turn = self.buffer.turn(now, (self.robot.dq,))
            asked = None if turn.asked is None else turn.asked.increment
            left = [*turn.left]
            if asked is not None:
                self.fates.setdefault(asked.cycle, []).append(None)
            for k in coming.get(now, []):
                dq = motion[k] if k < len(motion) else 0.0
                one = self.buffer.put(
                    Asked(Increment(robot="fr", seq=k, cycle=k, dq=(dq,)), 1, None, now), now
                )
                left += [] if one is None else [one]
            for one in left:
                self.fates.setdefault(one.asked.increment.cycle, []).append(one.fate)
            self.robot.cycle(None if asked is None else asked.dq[0])


def ramp(cycles: int, speed: float) -> list[float]:
    """Up to a speed, along, and to rest again, with half of the acceleration that is allowed."""
    up = np.minimum(np.arange(1, cycles + 1) * 0.5 * MAX_DV[0], speed)
    return [float(dq) for dq in np.minimum(up, up[::-1])]


def test_over_an_even_link_increments_pass_bit_for_bit_without_deferred_motion() -> None:
    carried, dq = new_carried(), (0.1 + 0.2,)
    assert carried.add_to(dq, (0.0,)) is not None
    assert carried.add_to(dq, (0.0,)) == dq
    assert carried.owed is None


@pytest.mark.parametrize("late_cycles", [1, 2, 5, MOST_CARRIED_CYCLES])
def test_delayed_increments_lose_no_motion_and_exceed_no_limit(late_cycles: int) -> None:
    motion, way = ramp(400, 0.004), Way()
    ages = [[max(5, 200 + late_cycles + 5 - k)] if k >= 200 else [5] for k in range(400)]
    way.run(motion, ages)
    assert way.robot.q_cmd == pytest.approx(sum(motion), abs=1e-9)
    carried = [fate for fates in way.fates.values() for fate in fates].count(Fate.CARRIED)
    assert 0 < carried <= late_cycles
    assert way.robot.hardest <= MAX_DV[0] * (1 + 1e-9)
    assert way.robot.fastest <= 0.004 * (1 + 3 * late_cycles / SPREAD_CYCLES)
    assert way.robot.cut < 1e-9, "nothing was left for the gate to scale"


def test_an_increment_too_late_to_be_deferred_is_refused_and_moves_nothing() -> None:
    way = Way()
    ages = [[5]] * 100
    ages[60] = [5 + MOST_CARRIED_CYCLES + 2]
    way.run([0.0] * 60 + [0.001] + [0.0] * 39, ages)
    assert way.fates[60] == [Fate.LATE]
    assert way.robot.q_cmd == 0.0


def test_of_two_answers_to_one_state_only_one_moves_the_robot() -> None:
    way = Way()
    ages = [[5]] * 150
    ages[60] = [8, 9, 10]
    way.run([0.0] * 60 + [0.001] + [0.0] * 89, ages)
    assert way.fates[60] == [Fate.CARRIED, Fate.SUPERSEDED, Fate.SUPERSEDED]
    assert way.robot.q_cmd == pytest.approx(0.001, abs=1e-12)


def test_a_lost_increment_is_not_compensated() -> None:
    motion, way = ramp(200, 0.004), Way()
    ages = [[] if k == 100 else [5] for k in range(200)]
    way.run(motion, ages)
    # the robot braked by one step in its cycle, and was sped up again within the next
    assert way.robot.q_cmd == pytest.approx(sum(motion), abs=0.0011)
    assert way.robot.q_cmd <= sum(motion)


def test_a_silence_of_the_controller_cancels_all_deferred_motion() -> None:
    way = Way()
    way.run([0.002] * 50, [[5]] * 50)
    assert way.told[-1][0].owed is None
    assert way.robot.dq == 0.0


def test_an_impossible_increment_goes_to_the_gate_and_at_most_a_cycle_is_deferred() -> None:
    carried = new_carried()
    carried.asked((1e308,))
    assert carried.owed == (0.01,)
    assert carried.add_to((-1e308,), (0.0,)) == (-1e308,)
    for _ in range(100):
        carried.asked((0.01,))
    assert carried.owed == pytest.approx((0.01 * MOST_CARRIED_CYCLES,))


@pytest.mark.long
@settings(max_examples=80, deadline=None)
@given(
    st.integers(1, 9),
    st.lists(st.lists(st.integers(0, 12), max_size=2), min_size=30, max_size=90),
    st.sampled_from([0.001, 0.003]),
)
@example(5, [[5]] * 40 + [[9], [8], [7]] + [[5]] * 20, 0.003)
def test_a_robot_ends_where_it_was_predicted_with_any_losses(
    usual: int, odd: list[list[int]], speed: float
) -> None:
    """Late, lost, doubled, out of order: what is told and what is in flight add up to where the robot comes to rest."""
    way = Way()
    ages = [[usual]] * 60 + odd + [[usual]] * 80
    motion = ramp(len(ages), speed)
    way.run(motion, ages)
    came = {k for k, after in enumerate(ages) if after}
    for k, fates in way.fates.items():
        assert k in came
        assert len(fates) == len(ages[k]), "one verdict for each"
        assert sum(fate in (None, Fate.CARRIED) for fate in fates) <= 1, "none moves the robot twice"
    assert way.robot.hardest <= MAX_DV[0] * (1 + 1e-9)
    assert way.told[-1][0].owed is None
    # once all of the odd ones have come, the account is right to the end, but for what the gate cut
    settled = 60 + len(odd) + 2 * 13
    told, q_cmd = way.told[settled]
    answered = -1 if told.answered_cycle is None else told.answered_cycle
    reckoned = q_cmd + (told.owed or (0.0,))[0] + sum(motion[k] for k in sorted(came) if k > answered)
    assert way.robot.q_cmd == pytest.approx(reckoned, abs=1e-9 + way.robot.cut)
