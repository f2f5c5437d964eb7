"""What the gate knows of one robot: its setpoints, the courses it may take, and where its drives may be."""

import numpy as np
import pytest
from small_cell import server_state, small_cell

from deltaq_protocol.guarded import Admission, Plan
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import DriveBounds, drives_of

LAG = 4
"""Setpoints that the drives may be at."""
CELL = small_cell()
CYCLE_S = CELL.cycle_s
FR, GR = CELL.robots["fr"], CELL.robots["gr"]
FR_DRIVES = DriveBounds(LAG - 1, FR.tracking_tolerance.copy(), 0.0)


@pytest.fixture
def tracker():
    return Tracker("fr", FR, FR_DRIVES, CYCLE_S)


def state(cycle, q_cmd=0.1, q=None, **changes):
    """A state in which every joint of FR is sent to `q_cmd` and is at `q`."""
    return server_state("fr", cycle, q_cmd=(q_cmd,) * 6, q=(q_cmd if q is None else q,) * 6, **changes)


def admission(sequence, dq=0.001, brake_cycles=2):
    return Admission(
        robot="fr",
        epoch=1,
        sequence=sequence,
        cycle=1,
        follows_sequence=1,
        follows_q_cmd=(0.1,) * 6,
        follows_dq=(0.0,) * 6,
        dq=(dq,) * 6,
        brake_cycles=brake_cycles,
    )


def first_joint(tube):
    """Where the first joint goes in a tube, setpoint by setpoint."""
    return tube.points[:, 0]


def test_every_new_cycle_is_accepted_and_a_repeated_one_is_not(tracker):
    assert tracker.observe(state(1, 0.1))
    assert tracker.observe(state(2, 0.2))
    assert not tracker.observe(state(2, 0.9))
    np.testing.assert_array_equal(tracker.q_cmd, np.full(6, 0.2))


def test_a_repeated_cycle_may_have_a_new_phase_unless_overtaken(tracker):
    tracker.observe(state(2, time_s=5.0))
    same_time, older = state(2, time_s=5.0), state(2, time_s=4.9)
    tracker.observe(same_time)
    assert tracker.state is same_time
    tracker.observe(older)
    assert tracker.state is same_time


@pytest.mark.parametrize("time_s", [4.9, 5.0, 500.0])
def test_an_overtaken_state_changes_nothing(tracker, time_s):
    newest = state(2, 0.2, time_s=5.0)
    tracker.observe(newest)
    assert not tracker.observe(state(1, 0.1, time_s=time_s))
    assert tracker.state is newest
    np.testing.assert_array_equal(tracker.q_cmd, np.full(6, 0.2))


def test_a_restarted_robot_server_is_followed_from_its_start(tracker):
    for cycle in range(50, 50 + LAG):
        tracker.observe(state(cycle, 0.2, time_s=5.0 + cycle))
    tracker.admitted(admission(9))
    assert tracker.observe(state(1, 0.5, process=2))
    np.testing.assert_allclose(first_joint(tracker.standing()), [0.2, 0.2, 0.2, 0.201, 0.2015, 0.5])
    for cycle in range(2, 1 + LAG):
        tracker.observe(state(cycle, 0.5, process=2))
    assert set(first_joint(tracker.standing())) == {0.5}
    assert (tracker.in_flight, tracker.missed) == ((), 0)


@pytest.mark.parametrize("first_cycle", [1, 51, 52, 900])
def test_a_restart_shows_in_the_first_state_of_the_new_process_and_in_no_other(tracker, first_cycle):
    seen = [tracker.restarted]
    states = [(1, 50), (1, 51), *((2, first_cycle + later) for later in (0, 1, 1))]
    for process, cycle in states:
        tracker.observe(state(cycle, process=process, time_s=5.0))
        seen.append(tracker.restarted)
    assert seen == [False, False, False, True, False, False]


def test_no_state_of_an_ended_process_is_taken(tracker):
    for process in (1, 2, 3):
        tracker.observe(state(10, process=process))
    newest = tracker.state
    for process in (1, 2):
        assert not tracker.observe(state(99, process=process, time_s=500.0))
    assert (tracker.state, tracker.restarted) == (newest, False)


def test_the_last_sixteen_ended_processes_are_remembered(tracker):
    for process in range(18):
        tracker.observe(state(10, process=process))
    assert tracker.snapshot().ended_processes == tuple(range(1, 17))


def is_displaced(tracker, cycles, travel, dq):
    """Whether a setpoint is displaced that is `travel` further on when it is heard again, all joints alike."""
    tracker.observe(state(10, 0.1))
    tracker.observe(state(10 + cycles, 0.1 + travel, dq=(dq,) * 6))
    return tracker.displaced


def test_a_setpoint_moved_by_its_increment_is_not_displaced(tracker):
    assert not is_displaced(tracker, 1, 0.001, 0.001)


@pytest.mark.parametrize(("travel", "dq"), [(0.0011, 0.001), (0.001, -0.001), (-0.001, 0.0)])
def test_a_setpoint_is_displaced_by_any_other_travel_than_its_increment(tracker, travel, dq):
    assert is_displaced(tracker, 1, travel, dq)


def test_a_setpoint_that_missed_its_increment_is_not_displaced(tracker):
    assert not is_displaced(tracker, 1, 0.0, 0.001)  # the KRC missed the reply


@pytest.mark.parametrize("unseen", [1, 2, 5])
def test_in_unheard_cycles_a_setpoint_may_have_moved_by_the_possible_motion(tracker, unseen):
    slowest = float(np.min(FR.max_velocity)) * CYCLE_S
    assert not is_displaced(tracker, 1 + unseen, 0.001 + (1 + 5e-7) * unseen * slowest, 0.001)


@pytest.mark.parametrize("unseen", [1, 2, 5])
def test_in_unheard_cycles_a_setpoint_cannot_have_moved_further(tracker, unseen):
    slowest = float(np.min(FR.max_velocity)) * CYCLE_S
    assert is_displaced(tracker, 1 + unseen, 0.001 + 1.001 * unseen * slowest, 0.001)


def test_admissions_that_the_next_state_does_not_follow_are_counted_as_missed(tracker):
    tracker.observe(state(1))
    for cycle, (sent, followed) in enumerate([(2, 1), (3, 1), (4, 4)], start=2):
        tracker.admitted(admission(sent))
        tracker.observe(state(cycle, sequence=followed))
        assert not tracker.in_flight
    assert tracker.missed == 2


def test_an_admission_of_another_epoch_is_a_different_one(tracker):
    tracker.observe(state(1))
    tracker.admitted(admission(2))
    tracker.observe(state(2, sequence=2, epoch=8))
    assert tracker.missed == 1


def test_the_brake_is_the_next_step_that_the_robot_server_will_send(tracker):
    plan = Plan(dq=(0.004,) * 6, brake_cycles=4, step=1)
    tracker.observe(state(1, plan=plan))
    np.testing.assert_allclose(tracker.brake(), np.full(6, 0.002))


def test_until_a_state_confirms_it_an_admission_is_a_second_candidate_trajectory(tracker):
    tracker.observe(state(1, plan=Plan(dq=(0.004,) * 6, brake_cycles=4, step=1)))
    assert [list(first_joint(tube)) for tube in tracker.tubes()] == [pytest.approx([0.1, 0.102, 0.103])]
    tracker.admitted(admission(2, dq=0.01, brake_cycles=2))
    braking, admitted = tracker.tubes()
    np.testing.assert_allclose(first_joint(braking), [0.1, 0.102, 0.103])
    np.testing.assert_allclose(first_joint(admitted), [0.1, 0.11, 0.115])


def test_tubes_of_setpoints_contain_every_candidate_trajectory_and_not_the_measurement(tracker):
    for cycle in range(1, LAG + 1):
        tracker.observe(state(cycle, 0.1, 0.7, plan=Plan(dq=(0.004,) * 6, brake_cycles=4, step=1)))
    tracker.admitted(admission(2, dq=0.01, brake_cycles=2))
    assert [list(first_joint(tube)) for tube in tracker.tubes_of_setpoints()] == [
        pytest.approx([0.1] * LAG + [0.102, 0.103]),
        pytest.approx([0.1] * LAG + [0.11, 0.115]),
    ]
    assert {tube.drives.lag for tube in tracker.tubes_of_setpoints()} == {LAG - 1}


def test_a_robot_stands_still_at_rest_without_admissions_in_flight(tracker):
    for cycle in range(1, LAG + 1):
        tracker.observe(state(cycle, 0.1))
        assert tracker.stands_still() is (cycle == LAG)
    tracker.admitted(admission(2))
    assert tracker.at_rest()
    assert not tracker.stands_still()


def test_a_tracker_is_of_one_robot_with_its_units(tracker):
    assert (tracker.name, tracker.units) == ("fr", FR.units)


def test_the_tube_begins_with_as_many_setpoints_as_the_drives_lag(tracker):
    for cycle in range(1, LAG + 3):
        tracker.observe(state(cycle, cycle / 10))
    np.testing.assert_allclose(first_joint(tracker.standing()), [0.3, 0.4, 0.5, 0.6])


@pytest.mark.parametrize("q", [0.19, 0.51])
def test_an_unexplained_measurement_belongs_to_the_tube(tracker, q):
    for cycle in range(1, LAG + 1):
        tracker.observe(state(cycle, 0.1 + cycle / 10, q))
    np.testing.assert_allclose(first_joint(tracker.standing()), [q, 0.2, 0.3, 0.4, 0.5])


@pytest.mark.parametrize("q", [(0.1, 0.2, 0.3, 0.4, 0.5, 0.55), (0.15, 0.2, 0.3, 0.4, 0.5, 0.6)])
def test_one_displaced_joint_adds_the_measurement_to_the_tube(tracker, q):
    setpoint = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
    for cycle in range(1, LAG + 1):
        tracker.observe(server_state("fr", cycle, q_cmd=setpoint, q=q))
    assert len(tracker.standing().points) == LAG + 1


def test_an_explained_measurement_does_not_belong_to_the_tube(tracker):
    for cycle in range(1, LAG + 1):
        tracker.observe(state(cycle, 0.1 + cycle / 10, 0.3))
    assert len(tracker.standing().points) == LAG


def test_in_a_new_session_the_robot_counts_at_the_setpoint_of_the_krc(tracker):
    for cycle in range(1, 1 + LAG):
        tracker.observe(state(cycle, 0.1))
    for cycle in range(1 + LAG, 1 + 2 * LAG):
        tracker.observe(state(cycle, 0.1, q=0.5, q_reset=(0.5,) * 6))
    assert tracker.at_rest()
    assert tracker.off_path() is None
    assert set(first_joint(tracker.standing())) == {0.5}
    np.testing.assert_array_equal(
        tracker.ahead.q_cmd, np.full(6, 0.5)
    )  # what is decided next goes on from there
    tracker.observe(state(1 + 2 * LAG, 0.5))  # the reset took it
    assert tracker.at_rest()


def test_a_robot_away_from_the_setpoint_of_a_new_session_is_off_its_path(tracker):
    for cycle in range(1, 1 + LAG):
        tracker.observe(state(cycle, 0.1, q=0.1, q_reset=(0.5,) * 6))
    assert tracker.off_path() is not None


def test_a_robot_is_at_rest_when_its_drives_settled_and_no_setpoint_remains(tracker):
    tracker.observe(state(1, 0.1))
    for cycle in range(2, LAG + 2):
        assert not tracker.at_rest()
        tracker.observe(state(cycle, 0.2))
    assert tracker.at_rest()
    tracker.observe(state(LAG + 2, 0.2, plan=Plan(dq=(0.001,) * 6, brake_cycles=3, step=0)))
    assert not tracker.at_rest()


@pytest.mark.parametrize(("lag_s", "setpoints"), [(1e-9, 2), (0.012, 2), (0.072, 7), (0.0721, 8), (0.12, 11)])
def test_the_setpoints_of_the_lag_are_kept(lag_s, setpoints):
    gate = CELL.gate.model_copy(update={"servo_lag_s": lag_s})
    tracker = Tracker("fr", FR, drives_of(FR, gate, CYCLE_S), CYCLE_S)
    for cycle in range(1, 20):
        tracker.observe(state(cycle, cycle / 10))
        assert tracker.is_known is (cycle >= setpoints)
    np.testing.assert_allclose(first_joint(tracker.standing())[[0, -1]], [(20 - setpoints) / 10, 1.9])


@pytest.mark.parametrize("sign", [1, -1])
def test_a_joint_may_be_off_its_path_by_its_tolerance_and_no_more(sign):
    tolerance = FR.tracking_tolerance[0]
    tracker = Tracker("fr", FR, FR_DRIVES, CYCLE_S)
    tracker.observe(state(1, 0.0, sign * tolerance))
    assert tracker.off_path() is None
    tracker.observe(state(2, 0.0, sign * tolerance * 1.01))
    joint, distance, allowed = tracker.off_path()
    assert (joint, allowed) == (0, tolerance)
    assert distance == pytest.approx(1.01 * tolerance)


def test_no_joint_is_off_its_path_between_its_own_setpoints(tracker):
    for cycle, share in enumerate([0.0, 0.5, 1.0], start=1):
        q_cmd = tuple(k + share * 0.2 for k in range(6))
        tracker.observe(server_state("fr", cycle, q_cmd=q_cmd, q=tuple(k + 0.05 for k in range(6))))
    assert tracker.off_path() is None
    for cycle, joint, q in ((8, 4, 1.0), (9, 1, 4.2)):
        elsewhere = tuple(q if k == joint else k + 0.05 for k in range(6))
        tracker.observe(tracker.state.model_copy(update={"cycle": cycle, "q": elsewhere}))
        assert tracker.off_path()[:2] == (joint, pytest.approx(3.0))


def test_the_joint_off_its_path_is_the_one_furthest_beyond_its_own_tolerance():
    tolerance = GR.tracking_tolerance
    assert tolerance[0] != tolerance[5]  # a prismatic joint in m, a revolute one in rad
    lesser, greater = sorted((0, 5), key=lambda joint: tolerance[joint])
    q = np.zeros(9)
    q[lesser], q[greater] = 1.9 * tolerance[lesser], 1.2 * tolerance[greater]
    assert q[greater] > q[lesser]
    tracker = Tracker("gr", GR, DriveBounds(LAG - 1, GR.tracking_tolerance.copy(), 0.0), CYCLE_S)
    tracker.observe(server_state("gr", 1, q_cmd=(0.0,) * 9, q=tuple(q)))
    assert tracker.off_path()[0] == lesser


def test_a_tracker_continues_from_a_restored_snapshot(tracker):
    tracker.observe(state(1, process=0))
    for cycle in range(1, LAG + 1):
        tracker.admitted(admission(7))
        tracker.observe(state(cycle, cycle / 10))
    tracker.admitted(admission(8))
    memory = tracker.snapshot()
    assert (memory.missed, memory.ended_processes) == (LAG - 1, (0,))
    assert memory.history == tuple((cycle / 10,) * 6 for cycle in range(1, LAG + 1))
    assert (memory.state, memory.in_flight) == (tracker.state, tracker.in_flight)
    heir = Tracker("fr", FR, FR_DRIVES, CYCLE_S)
    heir.observe(state(99, 5.0))
    heir.restore(memory)
    assert heir.snapshot() == memory
    np.testing.assert_array_equal(first_joint(heir.tubes()[1]), first_joint(tracker.tubes()[1]))


def two_in_flight():
    """A robot with a lookahead, and two admissions that follow one another."""
    tracker = Tracker("fr", FR, FR_DRIVES, CYCLE_S, lookahead_cycles=3)
    tracker.observe(state(1))
    first = admission(2)
    follows = {"follows_sequence": 2, "follows_q_cmd": (0.101,) * 6, "follows_dq": first.dq}
    second = first.model_copy(update={"sequence": 3, "cycle": 2, **follows})
    for sent in (first, second):
        tracker.admitted(sent)
    return tracker, first, second


def test_with_a_lookahead_a_trajectory_passes_all_admissions_in_flight():
    tracker, _, _ = two_in_flight()
    course = tracker.course(np.full(6, 0.002), brake_cycles=2)
    to_come = course.setpoints(tracker.q_cmd)[:, 0]
    np.testing.assert_allclose(to_come, [0.101, 0.102, 0.104, 0.105])
    in_tube = first_joint(tracker.tube(course))
    assert np.isin(np.round(to_come, 9), np.round(in_tube, 9)).all()


def test_with_a_lookahead_due_admissions_do_not_count_as_missed():
    tracker, first, second = two_in_flight()
    plan = Plan(dq=first.dq, brake_cycles=2, step=0)
    tracker.observe(state(2, 0.101, dq=first.dq, sequence=2, plan=plan))
    assert (tracker.missed, tracker.in_flight) == (0, (second,))


def moving_in_flight():
    """A robot with three admissions in flight, what it is sent if it takes them all, and those setpoints."""
    tracker = Tracker(
        "fr", FR, DriveBounds(7, FR.tracking_tolerance.copy(), 0.0), CYCLE_S, lookahead_cycles=4
    )
    still = Plan(dq=(0.0,) * 6, brake_cycles=1, step=1)
    for cycle in range(1, 11):
        tracker.observe(server_state("fr", cycle, q_cmd=(0.0,) * 6, q=(0.0,) * 6, dq=(0.0,) * 6, plan=still))
    sent = []
    motion = tracker.ahead
    for count in range(1, 4):
        dq = (0.001 * count, -0.001, 0.0, 0.0, 0.0, 0.0)
        told = Admission(
            robot="fr",
            epoch=1,
            sequence=1 + count,
            cycle=9 + count,
            follows_sequence=motion.sequence,
            follows_q_cmd=tuple(motion.q_cmd.tolist()),
            follows_dq=tuple(motion.dq.tolist()),
            dq=dq,
            brake_cycles=3,
        )
        tracker.admitted(told)
        motion = motion.admitted(told)
        sent.append(motion.q_cmd)
    return tracker, motion, sent


def state_of(motion, cycle):
    q = tuple(motion.q_cmd.tolist())
    plan = Plan(dq=tuple(motion.plan_dq.tolist()), brake_cycles=motion.brake_cycles, step=motion.step)
    return server_state(
        "fr", cycle, q=q, q_cmd=q, dq=tuple(motion.dq.tolist()), plan=plan, sequence=motion.sequence
    )


def test_setpoints_of_unheard_cycles_are_remembered_as_sent():
    tracker, motion, sent = moving_in_flight()
    assert tracker.observe(state_of(motion, 13))
    np.testing.assert_array_equal(tracker.standing().points[-3:], sent)
    assert len(tracker.standing().points) == 8


def test_unknown_setpoints_are_replaced_by_all_possible_ones_for_the_lag():
    tracker, motion, sent = moving_in_flight()
    elsewhere = state_of(motion, 13)
    off = tuple((np.array(elsewhere.q_cmd) + 1e-6).tolist())
    assert tracker.observe(elsewhere.model_copy(update={"q_cmd": off, "q": off}))
    for cycle in range(14, 21):
        points = tracker.standing().points
        assert all(any(np.array_equal(setpoint, point) for point in points) for setpoint in sent)
        still = Plan(dq=(0.0,) * 6, brake_cycles=1, step=1)
        tracker.observe(server_state("fr", cycle, q_cmd=off, q=off, dq=(0.0,) * 6, plan=still, sequence=4))
    assert tracker.at_rest()


def test_a_setpoint_missed_by_the_krc_drops_no_earlier_one():
    tracker, motion, _ = moving_in_flight()
    # each telegram tells that the reply before it was missed, so the same setpoint is sent again
    for cycle in range(13, 17):
        tracker.observe(state_of(motion, cycle))
    points = tracker.standing().points
    assert len(points) == 8 + 3
    np.testing.assert_array_equal(points[0], np.zeros(6))


def test_a_jump_of_cycles_takes_no_time(tracker):
    tracker.observe(state(1))
    assert tracker.observe(state(2**52, 0.2))
    np.testing.assert_allclose(tracker.q_cmd, 0.2)
