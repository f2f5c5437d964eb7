"""Driving an option's path through the gate, in virtual time."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.advisor import Option, advise
from deltaq_controllers.advisor.driving import PathController, timed
from deltaq_controllers.advisor.problem import Problem
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_experiments.lockstep import Lockstep
from deltaq_protocol.messages import Outcome

Array = NDArray[np.float64]

CELL = CellModel.load("dawm")
DAWM = CELL.robots["dawm"]
TRACKER = ConstraintTracker(DAWM)
CYCLE_S = CELL.description.cycle_s


@pytest.fixture(scope="module")
def option() -> Option:
    task = Problem(CELL, "dawm", TRACKER.hands(DAWM.home), None, TRACKER)
    found = advise(task, DAWM.home, generator=np.random.default_rng(1), options=3)
    return next(option for option in found if option.path is not None)


def path_of(option: Option) -> Array:
    assert option.path is not None
    return option.path


def test_a_timed_path_keeps_the_joints_limits_and_begins_and_ends_at_rest(option: Option) -> None:
    setpoints = timed(path_of(option), TRACKER, CYCLE_S)
    dq = np.diff(setpoints, axis=0, prepend=setpoints[:1], append=setpoints[-1:])
    assert np.all(np.abs(dq) <= 0.7 * DAWM.max_velocity * CYCLE_S)
    change = np.abs(np.diff(dq, axis=0)) / (DAWM.max_acceleration * CYCLE_S**2)
    assert np.percentile(change.max(axis=1), 95) < 1.0
    np.testing.assert_array_equal(setpoints[0], path_of(option)[0])
    np.testing.assert_array_equal(setpoints[-1], path_of(option)[-1])


def test_a_single_straight_piece_and_a_path_of_one_point_are_timed_too() -> None:
    base = DAWM.home[TRACKER.base] + 0.05
    (goal,) = TRACKER.track(base[None], TRACKER.hands(DAWM.home), DAWM.home)
    setpoints = timed(np.stack([DAWM.home, goal]), TRACKER, CYCLE_S)
    assert len(setpoints) > 20
    np.testing.assert_array_equal(setpoints[-1], goal)
    assert len(timed(DAWM.home[None], TRACKER, CYCLE_S)) == 1


def test_every_setpoint_of_a_timed_path_holds_the_hands_to_1e_9(option: Option) -> None:
    poses = TRACKER.hands(DAWM.home)
    for q in timed(path_of(option), TRACKER, CYCLE_S):
        assert np.abs(TRACKER.hands(q) - poses).max() < 1e-9


@pytest.mark.parametrize(
    ("silent_cycles", "at_most_m", "at_most_deg"),
    # while the robot brakes, on a straight line in its joints, the hands can do no better
    [(0, 1e-4, 0.01), (4, 1e-3, 0.1)],
    ids=["answering every cycle", "falling silent on the way"],
)
def test_a_path_is_driven_through_the_gate_with_the_hands_still(
    option: Option, silent_cycles: int, at_most_m: float, at_most_deg: float
) -> None:
    setpoints = timed(path_of(option), TRACKER, CYCLE_S)
    controller = PathController(setpoints)
    stack = Lockstep("dawm")
    stack.run_until_ready()
    stack.acquire("dawm", "advisor")
    poses = TRACKER.hands(DAWM.home)
    worst_m, worst_rad = 0.0, 0.0
    outcomes: list[Outcome] = []
    for cycle in range(4 * len(setpoints)):
        stack.cycle()
        state = stack.arms["dawm"].state
        assert state is not None
        increment = controller.increment(View(RobotView.from_state(state)))
        if controller.finished:
            break
        if 100 <= cycle < 100 + silent_cycles:
            continue
        verdict = stack.ask("dawm", increment)
        assert verdict is not None
        outcomes.append(verdict.outcome)
        for now, then in zip(TRACKER.hands(np.array(state.q)), poses, strict=True):
            worst_m = max(worst_m, float(np.linalg.norm(now[:3, 3] - then[:3, 3])))
            worst_rad = max(worst_rad, float(np.linalg.norm(pin.log3(now[:3, :3] @ then[:3, :3].T))))
    assert controller.finished
    assert set(outcomes) <= {Outcome.ADMITTED, Outcome.SCALED}
    assert outcomes.count(Outcome.ADMITTED) > 0.9 * len(outcomes)
    assert worst_m < at_most_m
    assert np.rad2deg(worst_rad) < at_most_deg
    state = stack.arms["dawm"].state
    assert state is not None
    np.testing.assert_allclose(state.q_cmd, option.q, atol=1e-6)
