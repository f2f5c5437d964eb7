"""Robot Servers on hosts of their own: how old one robot's state is beside another's, in virtual time."""

import asyncio
import random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab
from hypothesis import given
from hypothesis import strategies as st
from told import told_state, told_status

from deltaq_controllers.camera_follower import MOST_CHANGES, Sightings
from deltaq_controllers.interface import RobotView
from deltaq_controllers.robot_clocks import MAX_DRIFT, ClockReading, PathClock, RobotClocks, robot_clock_s
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import RobotState, Sight, Status

OFFSETS = [(0.0, 0.0), (0.3, 0.0), (-0.3, 0.0), (5.0, 0.0), (-5.0, 0.0), (0.0, 1.0), (5.0, 1.0), (-0.3, -1.0)]


class Hosts:
    """`fr` and `gr` on two hosts, and their controller on a third.

    Args:
        offset_s: by how much the clock of `gr` is ahead when it begins; that of `fr` is by as much behind.
        drift: by how much they go on to part [s/s].
    """

    def __init__(self, offset_s: float, drift: float) -> None:
        self.offset_s, self.drift = offset_s, drift
        self.clocks = RobotClocks(("fr", "gr"), CYCLE_S)
        self._random = random.Random(5)

    def stamp_s(self, robot: str, time_s: float) -> float:
        """What a robot's server stamps at a time."""
        sign = 1.0 if robot == "gr" else -1.0
        return time_s + 0.5 * sign * (self.offset_s + self.drift * time_s)

    def ask(self, cycle: int) -> None:
        """An exchange with the HLI, whose ways there and back take 5 to 40 ms each."""
        there_s, back_s = self._random.uniform(0.005, 0.04), self._random.uniform(0.005, 0.04)
        read_s = cycle * CYCLE_S + there_s
        newest = int(read_s / CYCLE_S)
        heard = (newest, read_s - newest * CYCLE_S)
        states = {
            robot: told_state(cycle, self.stamp_s(robot, cycle * CYCLE_S), robot) for robot in ("fr", "gr")
        }
        self.clocks.take(cycle * CYCLE_S, told_status(fr=heard, gr=heard), read_s + back_s, states)

    def age_s(self, other: Foreseen, cycle: int, known: int) -> float:
        """Age of `gr` as `fr` sees it, in a cycle in which another is the newest that is known of `gr`."""
        time_s = self.stamp_s("fr", cycle * CYCLE_S)
        stamp_s = self.clocks.on_clock_of("fr", "gr", self.stamp_s("gr", known * CYCLE_S))
        assert stamp_s is not None
        own = RobotView(cycle, time_s, np.zeros(6), np.zeros(6))
        other.update(own, RobotView(known, stamp_s, np.zeros(9), np.zeros(9)))
        return other.age_s


@pytest.mark.parametrize(("offset_s", "drift"), [(offset, part * MAX_DRIFT) for offset, part in OFFSETS])
def test_the_age_of_a_view_is_independent_of_the_hosts_clocks(offset_s: float, drift: float) -> None:
    hosts, other = Hosts(offset_s, drift), Foreseen(lab().robots["gr"], lab().robots["fr"], CYCLE_S)
    for cycle in range(5):
        hosts.ask(cycle)
    end = round(1200.0 / CYCLE_S)
    for cycle in range(10, end, 166):
        hosts.ask(cycle)
        late = 2 + cycle % 5
        age_s = hosts.age_s(other, cycle, cycle - late)
        assert age_s == pytest.approx(late * CYCLE_S, abs=0.008)
        assert other.sight is Sight.FRESH
    assert hosts.age_s(other, end, end - 20) == pytest.approx(20 * CYCLE_S, abs=0.008)
    assert other.sight is Sight.STALE
    assert hosts.age_s(other, end, end - 100) == pytest.approx(100 * CYCLE_S, abs=0.008)
    assert other.sight is Sight.LOST


def test_a_view_that_arrives_old_is_reported_as_old() -> None:
    hosts, other = Hosts(5.0, 0.0), Foreseen(lab().robots["gr"], lab().robots["fr"], CYCLE_S)
    hosts.ask(200)
    assert hosts.age_s(other, 200, 50) == pytest.approx(150 * CYCLE_S)
    assert other.sight is Sight.LOST


def test_reading_the_clocks_again_does_not_change_earlier_stamps() -> None:
    hosts = Hosts(5.0, 0.0)
    hosts.ask(0)
    before = hosts.clocks.on_clock_of("fr", "gr", 7.0)
    assert before is not None
    hosts.offset_s = 6.0
    for cycle in (1000, 2000):
        hosts.ask(cycle)
        assert hosts.clocks.on_clock_of("fr", "gr", 7.0) == before
    assert hosts.clocks.on_clock_of("fr", "gr", 7.5) == pytest.approx(before + 0.5 - 1.0)


def test_with_an_unknown_clock_no_stamp_is_converted_and_no_age_reported() -> None:
    clocks = RobotClocks(("fr", "gr"), CYCLE_S)
    clocks.take(0.0, told_status(fr=(1, 0.0)), 0.01, {"fr": told_state(1, 0.0)})
    assert (clocks.knows("fr"), clocks.knows("gr")) == (True, False)
    assert clocks.on_clock_of("fr", "gr", 7.0) is None
    assert clocks.age_s("gr", 7.0, 8.0) is None
    assert clocks.age_s("fr", 0.005, 1.0) == pytest.approx(0.99)
    assert clocks.summary(0.01)["gr"] == {"offset_s": None, "error_s": None}


# The clock at the other end: how wrong the estimate may be, and how old a view is then.


WAY_S = st.floats(0.0, 0.5)
Ways = list[tuple[float, float]]


@given(
    st.floats(-1e5, 1e5),
    st.floats(-MAX_DRIFT, MAX_DRIFT),
    st.lists(st.tuples(WAY_S, WAY_S), min_size=1, max_size=20),
    st.floats(2.0, 200.0),
)
def test_a_drifting_clock_is_always_known_within_the_stated_error(
    offset_s: float, drift: float, ways: Ways, pause_s: float
) -> None:
    clock = PathClock()
    for k, (there_s, back_s) in enumerate(ways):
        asked_s = k * pause_s
        read_s = asked_s + there_s
        clock.take(asked_s, read_s + offset_s + drift * read_s, read_s + back_s)
        now_s = asked_s + pause_s
        assert abs(clock.offset_s - (offset_s + drift * now_s)) <= clock.error_s(now_s) + 1e-9


def test_the_quickest_exchange_counts_until_drift_makes_a_newer_one_more_accurate() -> None:
    clock = PathClock()
    clock.take(0.0, 5.0, 0.002)
    assert clock.error_s(0.002) == pytest.approx(0.001, abs=1e-6)
    clock.take(10.0, 15.008, 10.006)
    assert (clock.offset_s, clock.error_s(10.002)) == pytest.approx((4.999, 0.002), abs=1e-5)
    clock.take(30.0, 35.008, 30.006)
    assert (clock.offset_s, clock.error_s(30.006)) == pytest.approx((5.005, 0.003), abs=1e-5)


def test_a_set_clock_is_accepted_at_the_second_reading_and_a_late_stamp_never() -> None:
    clock = PathClock()
    clock.take(0.0, 5.0, 0.002)
    clock.take(2.0, 6.5, 2.002)
    clock.take(4.0, 9.0, 4.002)
    assert clock.offset_s == pytest.approx(4.999)
    clock.take(6.0, 106.0, 6.002)
    assert clock.offset_s == pytest.approx(4.999)
    clock.take(8.0, 108.0, 8.002)
    assert clock.offset_s == pytest.approx(99.999)


def test_a_clock_set_during_a_reading_is_refused_with_both_times() -> None:
    with pytest.raises(ValueError, match=r"answered_s: 1\.0 is before the request, 2\.0"):
        PathClock().take(2.0, 5.0, 1.0)


def test_a_status_gives_the_clock_of_a_robot_server_in_whole_cycles() -> None:
    status = told_status(fr=(110, 0.004))
    assert robot_clock_s(status, told_state(cycle=100, time_s=50.0), 0.012) == pytest.approx(
        50.0 + 10 * 0.012 + 0.004
    )


def test_a_robot_unknown_to_the_hli_has_no_clock() -> None:
    assert robot_clock_s(told_status(fr=(0, None)), told_state(cycle=1, time_s=5.0), 0.012) is None
    other = told_state(cycle=1, time_s=5.0, robot="gr")
    assert robot_clock_s(told_status(fr=(1, 0.0)), other, 0.012) is None


def test_a_restarted_robot_server_is_not_read_by_the_cycles_of_its_predecessor() -> None:
    assert robot_clock_s(told_status(fr=(3, 0.0)), told_state(cycle=100, time_s=50.0), 0.012) is None


def test_sightings_record_stale_lost_and_fresh_views_and_drop_the_oldest() -> None:
    sightings = Sightings()
    order = [Sight.FRESH, Sight.FRESH, Sight.STALE, Sight.LOST, Sight.LOST, Sight.FRESH]
    changed = [sightings.add(sight, 0.1 * k, float(k)) for k, sight in enumerate(order)]
    assert changed == [False, False, True, True, False, True]
    told = sightings.summary()
    assert (told["fresh"], told["view_stale"], told["view_lost"]) == (3, 1, 2)
    assert told["changes"][0] == {"time_s": 2.0, "sight": "view_stale", "age_s": pytest.approx(0.2)}
    for k in range(MOST_CHANGES):
        sightings.add((Sight.STALE, Sight.LOST)[k % 2], 0.0, 10.0 + k)
    changes = sightings.summary()["changes"]
    assert (len(changes), changes[0]["time_s"]) == (MOST_CHANGES, 10.0)


def test_a_permanently_stale_view_is_reported_from_the_first_cycle() -> None:
    assert Sightings().add(Sight.LOST, 0.0, 0.0)


# Clocks of Robot Servers are read by questions, of which a busy HLI may leave some unanswered.


class BusyCell:
    """Leaves the first questions unanswered, and answers the others when it is let."""

    robots = ("fr", "gr")
    description = SimpleNamespace(cycle_s=0.012)

    def __init__(self, unanswered: int, heard: tuple[str, ...] = ()) -> None:
        self.unanswered, self.heard, self.asked = unanswered, heard, 0
        self.answers = asyncio.Event()
        self.answers.set()

    async def status(self) -> Status:
        self.asked += 1
        await self.answers.wait()
        if self.asked <= self.unanswered:
            raise ServiceUnreachableError("no answer within 1 s")
        return told_status(**dict.fromkeys(self.heard, (7, 0.0)))

    def state(self, robot: str) -> RobotState | None:
        return told_state(7, 50.0, robot) if robot in self.heard else None


def reading_of(cell: Any) -> ClockReading:
    return ClockReading(cell)


async def test_a_late_answer_costs_one_reading_of_the_clocks() -> None:
    cell = BusyCell(unanswered=4, heard=("fr", "gr"))
    reading = reading_of(cell)
    await reading.read_first()
    assert cell.asked == 5
    assert reading.clocks.on_clock_of("fr", "gr", 50.0) == pytest.approx(50.0)


async def test_a_silent_hli_counts_as_lost() -> None:
    with pytest.raises(ServiceUnreachableError):
        await reading_of(BusyCell(unanswered=5)).read_first()


async def test_a_cycle_neither_waits_for_an_answer_nor_asks_again_before_it() -> None:
    cell = BusyCell(unanswered=0, heard=("fr",))
    cell.answers.clear()
    reading = reading_of(cell)
    for _ in range(5):
        reading.go_on()
        await asyncio.sleep(0)
    assert (cell.asked, reading.clocks.knows("fr")) == (1, False)
    cell.answers.set()
    while not reading.clocks.knows("fr"):
        await asyncio.sleep(0)


async def test_clocks_are_read_periodically_and_a_missing_answer_is_harmless(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr("deltaq_controllers.robot_clocks.time", SimpleNamespace(monotonic=lambda: now.s))
    cell = BusyCell(unanswered=1, heard=("fr",))
    reading = reading_of(cell)

    async def asked_after(pause_s: float) -> int:
        now.s += pause_s
        reading.go_on()
        for _ in range(5):
            await asyncio.sleep(0)
        return cell.asked

    assert await asked_after(0.0) == 1
    assert await asked_after(0.01) == 1
    assert await asked_after(0.2) == 2, "no clock is known yet"
    assert await asked_after(0.2) == 2
    assert await asked_after(2.0) == 3
    cell.heard = ("fr", "gr")
    assert await asked_after(0.2) == 4, "another robot is heard"
