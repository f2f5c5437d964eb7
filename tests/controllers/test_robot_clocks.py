"""Robot Servers on hosts of their own: how old one robot's state is beside another's, in virtual time."""

from __future__ import annotations

import random

import numpy as np
import pytest
from closed_loop import CYCLE_S, lab
from told import told_state, told_status

from deltaq_controllers.interface import RobotView
from deltaq_controllers.robot_clocks import MAX_DRIFT, RobotClocks
from deltaq_controllers.surroundings.setpoints import Foreseen
from deltaq_protocol.messages import Sight

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
def test_a_view_is_as_old_as_it_is_whatever_the_clocks_of_two_hosts_show(
    offset_s: float, drift: float
) -> None:
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


def test_a_view_that_is_old_when_it_is_first_seen_is_told_as_old() -> None:
    hosts, other = Hosts(5.0, 0.0), Foreseen(lab().robots["gr"], lab().robots["fr"], CYCLE_S)
    hosts.ask(200)
    assert hosts.age_s(other, 200, 50) == pytest.approx(150 * CYCLE_S)
    assert other.sight is Sight.LOST


def test_a_stamp_stays_where_it_is_when_the_clocks_are_read_again() -> None:
    hosts = Hosts(5.0, 0.0)
    hosts.ask(0)
    before = hosts.clocks.on_clock_of("fr", "gr", 7.0)
    assert before is not None
    hosts.offset_s = 6.0
    for cycle in (1000, 2000):
        hosts.ask(cycle)
        assert hosts.clocks.on_clock_of("fr", "gr", 7.0) == before
    assert hosts.clocks.on_clock_of("fr", "gr", 7.5) == pytest.approx(before + 0.5 - 1.0)


def test_while_one_clock_is_not_known_no_stamp_is_moved_and_no_age_told() -> None:
    clocks = RobotClocks(("fr", "gr"), CYCLE_S)
    clocks.take(0.0, told_status(fr=(1, 0.0)), 0.01, {"fr": told_state(1, 0.0)})
    assert (clocks.knows("fr"), clocks.knows("gr")) == (True, False)
    assert clocks.on_clock_of("fr", "gr", 7.0) is None
    assert clocks.age_s("gr", 7.0, 8.0) is None
    assert clocks.age_s("fr", 0.005, 1.0) == pytest.approx(0.99)
    assert clocks.summary(0.01)["gr"] == {"offset_s": None, "error_s": None}
