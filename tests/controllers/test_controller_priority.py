"""A control loop runs ahead of ordinary programs, and loses that if it does not wait."""

import os
import sys
import threading
from pathlib import Path

import pytest
from ran import ran

from deltaq_controllers.live import GREED_S, ahead_of_ordinary_programs
from deltaq_protocol.real_time import SIM_PLACE, SchedulingPriority, place_of_robot


def given() -> bool:
    """Whether this system gives real-time priority to this user."""
    with ahead_of_ordinary_programs() as allowed:
        return allowed


needs_priority = pytest.mark.skipif(not given(), reason="this user is given no real-time priority")


def schedule() -> tuple[int, int]:
    """Policy and priority of this thread; the policy without the flag that children are ordinary."""
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(0).sched_priority


@needs_priority
def test_a_control_loop_and_its_message_threads_have_real_time_priority_only_inside_the_block() -> None:
    asked, ended = threading.Event(), threading.Event()
    seen = []

    def carry() -> None:
        asked.wait()
        seen.append(schedule())
        ended.set()

    thread = threading.Thread(target=carry)
    thread.start()
    before = schedule()
    with ahead_of_ordinary_programs():
        asked.set()
        ended.wait()
        assert seen == [(os.SCHED_FIFO, SchedulingPriority.CONTROLLER)]
        assert schedule() == (os.SCHED_FIFO, SchedulingPriority.CONTROLLER)
    thread.join()
    assert schedule() == before == (os.SCHED_OTHER, 0)


@needs_priority
def test_a_controllers_child_has_ordinary_priority() -> None:
    program = "import os; print(os.sched_getscheduler(0))"
    with ahead_of_ordinary_programs():
        started = ran([sys.executable, "-c", program])
    assert int(started.stdout) == os.SCHED_OTHER


def processors() -> set[frozenset[int]]:
    """The processors of each thread of this process, those of equal threads once."""
    threads = [int(entry.name) for entry in Path("/proc/self/task").iterdir()]
    return {frozenset(os.sched_getaffinity(thread)) for thread in threads}


@needs_priority
def test_all_threads_of_a_control_loop_keep_to_one_processor_only_inside_the_block() -> None:
    ended = threading.Event()
    thread = threading.Thread(target=ended.wait)
    thread.start()
    before = processors()
    usable = sorted(os.sched_getaffinity(0))
    for place in (0, 1, 2 * len(usable) + 1):
        with ahead_of_ordinary_programs(place):
            assert processors() == {frozenset({usable[place % len(usable)]})}
        assert processors() == before
    ended.set()
    thread.join()


@needs_priority
def test_a_controller_that_computes_without_waiting_loses_its_priority_and_may_run_anywhere_again() -> None:
    usable = os.sched_getaffinity(0)
    with ahead_of_ordinary_programs(place=0):
        while schedule()[0] == os.SCHED_FIFO:
            sum(range(1000))
        assert schedule() == (os.SCHED_OTHER, 0)
        assert os.sched_getaffinity(0) == usable


def test_neighbours_in_a_cell_share_no_processor() -> None:
    robots = ("fr", "gr", "hr")
    places = [SIM_PLACE, *(place_of_robot(robots, robot) for robot in robots)]
    assert places == [0, 1, 2, 3]


def test_the_priority_of_a_controller_is_below_everything_that_answers_it() -> None:
    assert min(SchedulingPriority) is SchedulingPriority.CONTROLLER
    assert GREED_S < 1.0  # a lease outlasts it


def test_a_loop_in_another_thread_requests_no_priority() -> None:
    allowed = []

    def control() -> None:
        with ahead_of_ordinary_programs() as given_to_it:
            allowed.append((given_to_it, schedule()))

    thread = threading.Thread(target=control)
    thread.start()
    thread.join()
    assert allowed == [(False, (os.SCHED_OTHER, 0))]
