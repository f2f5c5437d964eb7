"""A cell in virtual time for a controller of one's own: what it finds, and that it finds it."""

import numpy as np
import pytest
from ramps import STEP_RAD, ClosedRamp, Ramp, goal_of

from deltaq_protocol.messages import Phase
from deltaq_testing.faults.controller import CellUseError
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.observed import NothingObservedError
from deltaq_testing.schedule import VIRTUAL, ScheduleError, fault
from deltaq_testing.virtual import CellUnderTest


@pytest.fixture(scope="module")
def lab():
    return load_rsi_cell("lab")


def run(lab, controller, *faults, duration_s=2.0, **more):
    cell = CellUnderTest(lab, "fr", **more)
    cell.drive(controller)
    cell.suffer(*faults)
    cell.run(duration_s)
    return cell


@pytest.mark.long
def test_a_cut_link_costs_only_an_open_loop_controller_its_goal(lab):
    cut = fault("link_cut", at_s=0.5, for_s=0.1)
    assert run(lab, Ramp).ended_at(goal_of(CellUnderTest(lab)), within=0.01)
    missed = run(lab, Ramp, cut)
    assert not missed.ended_at(goal_of(missed), within=0.01)
    assert run(lab, ClosedRamp, cut).ended_at(goal_of(missed), within=0.01)
    assert missed.kept_clear()
    assert missed.kept_limits()
    assert missed.rested_within(4)
    assert not missed.rested_within(3)


@pytest.mark.long
def test_a_frozen_controller_is_held_at_rest_and_resumes_after_the_operator(lab):
    cell = run(lab, ClosedRamp, fault("controller_frozen", at_s=0.5, for_s=1.2), duration_s=1.6)
    assert (cell.phase, cell.reason) == (Phase.HELD, "controller_lost")
    cell.run(0.4)
    assert cell.reason == "controller_lost"
    assert cell.recover()
    cell.run(2.0)
    assert (cell.reason, cell.reasons) == (None, ("controller_lost",))
    assert cell.ended_at(goal_of(cell), within=0.01)
    assert any("reset" in what for _, what in cell.events)


@pytest.mark.long
def test_a_restarted_process_gets_a_new_object_of_a_class_and_the_same_function(lab):
    made, called = [], []

    class Counting(ClosedRamp):
        def __init__(self):
            super().__init__()
            made.append(self)

    def stands(state):
        called.append(state.cycle)
        return [0.0] * 6

    dead = fault("controller_dead", at_s=0.5, for_s=0.2)
    assert run(lab, Counting, dead).recover()
    assert len(made) == 2
    cell = run(lab, stands, dead, duration_s=0.8)
    before = len(called)
    assert cell.recover()
    cell.run(0.5)
    assert len(called) > before


def test_an_error_of_a_controller_is_raised(lab):
    def fails(state):
        raise ZeroDivisionError("of the user's own")

    with pytest.raises(ZeroDivisionError, match="of the user's own"):
        run(lab, fails)


@pytest.mark.parametrize(
    ("dq", "reason"),
    [
        ([0.0] * 5, "bad_shape"),
        (["a"] * 6, "malformed"),
        (3.0, "bad_shape"),
        ([float("nan")] * 6, "not_finite"),
        ({"a": 1}, "malformed"),
    ],
    ids=["short", "text", "number", "nan", "map"],
)
def test_an_invalid_answer_is_refused_by_the_hli_and_moves_nothing(lab, dq, reason):
    cell = run(lab, lambda state: dq, duration_s=0.5)
    assert cell.refusals[reason] > 30
    assert cell.verdicts["admitted"] == 0
    np.testing.assert_allclose(cell.q, cell.model.robots["fr"].home, atol=1e-6)


def test_a_state_may_be_left_unanswered(lab):
    cell = run(lab, lambda state: np.full(6, STEP_RAD) if state.cycle % 2 else None, duration_s=0.5)
    assert 15 < cell.verdicts["admitted"] + cell.verdicts["scaled"] < 25


@pytest.mark.long
def test_an_excessive_request_is_scaled_within_limits(lab):
    cell = run(lab, lambda state: np.full(6, 0.5), duration_s=1.5)
    assert cell.kept_clear()
    assert cell.kept_limits()
    assert cell.verdicts["scaled"] > 10


def test_a_robot_at_a_forbidden_position_is_found(lab):
    q = CellUnderTest(lab).q.copy()
    q[1] = np.deg2rad(30)
    cell = CellUnderTest(lab)
    cell.history["fr"].q.append(q)
    cell.history["gr"].q.append(cell.history["gr"].q[-1])
    finding = cell.kept_clear()
    assert not finding
    assert "structure/floor" in repr(finding)


def test_a_setpoint_beyond_a_limit_is_found(lab):
    cell = run(lab, ClosedRamp, duration_s=0.2)
    assert cell.kept_limits()
    cell.history["fr"].setpoints.append(cell.model.robots["fr"].upper + 0.1)
    finding = cell.kept_limits()
    assert not finding
    assert "fr: 6 setpoints beyond a joint limit" in repr(finding)


def test_a_controller_of_deltaq_sees_the_other_robot_and_both_can_be_driven(lab):
    seen = []

    class Follows:
        def increment(self, view):
            seen.append(view.others["gr"].q)
            return np.zeros(6)

    cell = CellUnderTest(lab, "fr")
    cell.drive(Follows)
    cell.drive(lambda state: np.full(len(state.q), 1e-4), robot="gr")
    cell.run(0.5)
    assert (seen[-1] - seen[0] > 0).all()


@pytest.mark.long
def test_one_seed_is_one_run(lab):
    def rows(seed):
        faults = (fault("link_lossy", at_s=0.2, for_s=1), fault("krc_jitter", at_s=0.3, for_s=0.5))
        cell = run(lab, Ramp, *faults, seed=seed, duration_s=1.0)
        return np.array(cell.history["fr"].setpoints), cell.events

    (one, told), (same, told_again), (other, _) = rows(1), rows(1), rows(2)
    np.testing.assert_array_equal(one, same)
    assert told == told_again
    assert (one != other).any()


@pytest.mark.long
def test_a_late_refusal_does_not_revoke_a_granted_lease(lab):
    # as hypothesis shrank it: the request is overtaken by the next one, which is granted
    overtaken = fault("link_reordering", at_s=0, for_s=0.024)
    doubled = fault("link_duplicating", at_s=0.12, for_s=0.012)
    cell = run(lab, ClosedRamp, overtaken, doubled, duration_s=1.5)
    assert cell.ended_at(goal_of(cell), within=0.01)


def test_the_tracking_error_is_the_greatest_of_all_joints(lab):
    cell = run(lab, lambda state: [0.0] * 6, duration_s=0.5)
    error = cell.tracking_error(lambda time_s: cell.model.robots["fr"].home + np.eye(6)[2] * time_s)
    assert (error.max, error.final) == pytest.approx((0.504, 0.504), abs=1e-3)
    assert error.rms == pytest.approx(0.504 / 3**0.5, rel=0.02)
    with pytest.raises(
        NothingObservedError, match=r"reference must have 6 joints, one for each of fr, got \(2,\)"
    ):
        cell.tracking_error(lambda time_s: [0, 0])


def test_nonsensical_options_are_refused(lab):
    cell = CellUnderTest(lab)
    with pytest.raises(CellUseError, match="no controller drives fr: call drive"):
        cell.run(1.0)
    with pytest.raises(CellUseError, match=r"no robot 'r2' in this cell; it has fr, gr"):
        cell.drive(Ramp, robot="r2")
    with pytest.raises(CellUseError, match="a controller is a function of a state"):
        cell.drive(3)
    cell.drive(Ramp)
    with pytest.raises(CellUseError, match="fr has a controller already"):
        cell.drive(Ramp)
    cell.run(0.5)
    with pytest.raises(ScheduleError, match=r"at_s must be 0.504 or later"):
        cell.suffer(fault("sim_dead", at_s=0.1))
    with pytest.raises(NothingObservedError, match="no fault has started yet"):
        cell.rested_within(4)


def test_a_fault_without_effect_on_a_krc_is_noted_and_the_run_continues(lab):
    off = fault("krc_drives_off", at_s=0.2, for_s=0.1)
    cell = run(lab, Ramp, off, fault("krc_restarted", at_s=0.6, for_s=0.1), duration_s=1.0)
    assert any("krc-restarted begins without effect: " in what for _, what in cell.events)
    assert cell.recover()


@pytest.mark.nightly
@pytest.mark.parametrize("row", VIRTUAL, ids=lambda row: row.name)
def test_every_fault_can_be_injected_and_breaks_no_limit(lab, row):
    cell = run(lab, ClosedRamp, fault(row.name, at_s=0.5, for_s=1.0), duration_s=2.5)
    assert cell.recover()
    cell.run(2.0)
    assert cell.kept_clear()
    assert cell.kept_limits()
