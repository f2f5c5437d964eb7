"""Trajectories of ROS in virtual time, through the real gate: kept to the path, however much is admitted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ros_points import ATTACHMENT, point, trajectory
from small_cell import small_cell, tool_pose

from deltaq_cell.cell_model import robot_summary
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.ros2.messages import JointTrajectory
from deltaq_controllers.ros2.mover import TrajectoryFollower, TrajectoryMover
from deltaq_controllers.ros2.trajectory import Path
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Phase, RobotState, Verdict
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.schedule import fault
from deltaq_testing.virtual import CellUnderTest

MOVED = np.array([0.3, -0.1, 0.15, 0.2, -0.2, 0.3])


class Driven:
    """A cell in virtual time whose robot a mover moves, with what it said and asked for."""

    def __init__(self, lab: Any, robot: str = "fr") -> None:
        self.cell = CellUnderTest(lab, robot)
        description = self.cell.model.description.robots[robot]
        self.summary = robot_summary(description, self.cell.cycle_s)
        self.said: list[tuple[str, dict[str, Any]]] = []
        self.mover = TrajectoryMover(
            robot,
            self.summary,
            self.cell.cycle_s,
            lambda text, fields: self.said.append((text, dict(fields))),
        )
        self.home = self.cell.q.copy()
        self.paths: list[Path] = []
        self._told = self.cell.note
        self.cell.note = self._note  # type: ignore[method-assign]  # the mover hears verdicts as in a live cell
        self.cell.drive(self._increment)

    def hear(self, *points: Any) -> None:
        message = trajectory(self.summary.joints, *points) if points else JointTrajectory()
        self.mover.hear(message.encode(), ATTACHMENT, 0)

    def _note(self, message: Any) -> None:
        self._told(message)
        if isinstance(message, Verdict):
            self.mover.judged(message)

    def _increment(self, state: RobotState) -> Array:
        dq = self.mover.increment(state, View(RobotView.from_state(state)))
        follower: TrajectoryFollower | None = self.mover._driven
        if follower is not None and (not self.paths or self.paths[-1] is not follower.path):
            self.paths.append(follower.path)
        return dq

    @property
    def endings(self) -> list[str]:
        return [fields["ending"] for _, fields in self.said if fields["event"] == "ended"]

    def off_path(self) -> float:
        """The farthest that a setpoint was from all paths [rad], to the samples' spacing."""
        samples = np.concatenate([path.at(np.linspace(0, path.duration_s, 20_001)) for path in self.paths])
        setpoints = np.array(self.cell.history[self.cell.robot].setpoints)[self.cell.ready_row :: 4]
        return max(float(np.abs(samples - q).max(axis=1).min()) for q in setpoints)

    def kept(self) -> bool:
        return bool(self.cell.kept_clear()) and bool(self.cell.kept_limits())


@pytest.fixture(scope="module")
def lab() -> Any:
    return load_rsi_cell("lab")


@pytest.mark.long
def test_a_smooth_trajectory_is_driven_in_its_own_time_and_every_increment_is_admitted(lab: Any) -> None:
    driven = Driven(lab)
    middle, v = driven.home + MOVED, 0.5 * MOVED
    driven.hear(point(1.5, middle, v), point(3.0, middle + 0.5 * MOVED, 0.0 * v))
    driven.cell.run(3.2)
    assert driven.endings == ["arrived"]
    assert not driven.mover.has_work
    assert set(driven.cell.verdicts) == {"admitted"}
    np.testing.assert_allclose(driven.cell.q, driven.home + 1.5 * MOVED, atol=1e-6)
    assert driven.off_path() < 1e-4
    assert driven.kept()


@pytest.mark.long
def test_straight_pieces_are_slowed_down_at_their_corners_and_kept_to(lab: Any) -> None:
    driven = Driven(lab)
    home, aside = driven.home, np.array([0.2, 0.0, 0.0, 0.0, 0.2, 0.0])
    # the third point goes back over the way that was come
    driven.hear(*(point(t, q) for t, q in ((0, home), (0.5, home + aside), (1.0, home), (1.5, home + MOVED))))
    driven.cell.run(1.5)
    assert driven.mover.done is not None
    assert 0.8 < driven.mover.done < 1.0
    driven.cell.run(0.5)
    assert driven.endings == ["arrived"]
    assert set(driven.cell.verdicts) == {"admitted"}
    assert driven.off_path() < 1e-4


@pytest.mark.long
def test_a_path_that_ends_where_it_began_is_driven_all_the_same(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(0.5, driven.home + 0.3 * MOVED), point(1.0, driven.home))
    driven.cell.run(0.5)
    assert np.abs(driven.cell.q - driven.home).max() > 0.05
    driven.cell.run(0.8)
    assert driven.endings == ["arrived"]
    np.testing.assert_allclose(driven.cell.q, driven.home, atol=1e-6)


@pytest.mark.long
def test_cycles_that_were_missed_stretch_the_time_and_the_robot_comes_back_to_its_path(lab: Any) -> None:
    driven = Driven(lab)
    cut = fault("controller_hli_cut", at_s=0.4, for_s=0.12)
    driven.cell.suffer(cut, fault("hli_sim_lossy", at_s=0.8, for_s=0.5))
    driven.hear(point(0.7, driven.home + MOVED, MOVED), point(1.4, driven.home + 1.5 * MOVED, 0 * MOVED))
    driven.cell.run(3.0)
    assert driven.endings == ["arrived"]
    np.testing.assert_allclose(driven.cell.q, driven.home + 1.5 * MOVED, atol=1e-6)
    assert driven.off_path() < 5e-3
    assert driven.kept()


@pytest.mark.long
def test_an_empty_trajectory_brings_the_robot_to_rest_on_its_path(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(1.0)
    driven.hear()
    driven.cell.run(0.5)
    assert driven.endings == ["stopped"]
    rested = driven.cell.q.copy()
    assert 0.3 < ((rested - driven.home) / MOVED).min() < 0.8
    driven.cell.run(0.2)
    np.testing.assert_allclose(driven.cell.q, rested, atol=1e-9)
    assert driven.off_path() < 1e-4
    assert driven.mover.counters == {"trajectories": 1, "stops": 1, "ended_stopped": 1}


@pytest.mark.long
def test_a_new_trajectory_takes_the_place_of_the_old_from_where_the_robot_came_to_rest(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(0.8)
    driven.hear(point(1, driven.home - 0.3 * MOVED))
    driven.hear(point(1, driven.home - 0.5 * MOVED))
    driven.cell.run(2.0)
    assert driven.endings == ["stopped", "arrived"]
    assert len(driven.paths) == 2
    np.testing.assert_allclose(driven.cell.q, driven.home - 0.5 * MOVED, atol=1e-6)
    assert driven.off_path() < 1e-4


@pytest.mark.long
def test_a_stop_by_an_operator_ends_it_and_nothing_resumes_after_the_reset(lab: Any) -> None:
    driven = Driven(lab)
    driven.cell.suffer(fault("operator_stop", at_s=0.5))
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(1.0)
    assert driven.said[-1][0] == "fr: the trajectory has ended: the robot is held: operator_stop"
    driven.hear(point(2, driven.home + MOVED))
    driven.cell.run(0.1)
    assert driven.endings == ["lost", "lost"]
    assert driven.cell.recover()
    rested = driven.cell.q.copy()
    driven.cell.run(0.5)
    np.testing.assert_allclose(driven.cell.q, rested, atol=1e-9)
    driven.hear(point(1, driven.home))
    driven.cell.run(1.2)
    assert driven.endings == ["lost", "lost", "arrived"]


@pytest.mark.long
def test_what_the_gate_does_not_let_pass_is_stretched_and_given_up_with_the_gates_reason(lab: Any) -> None:
    driven = Driven(lab)
    down = driven.home.copy()
    down[1] = 0.5  # into the floor
    driven.hear(point(3, down))
    driven.cell.run(6.0)
    assert driven.endings == ["blocked"]
    assert "no way was made for 2 s; the gate last said clearance fr/" in driven.said[-1][0]
    assert driven.cell.verdicts["scaled"] > 0
    assert driven.cell.verdicts["held"] > 100
    assert driven.kept()
    assert driven.off_path() < 1e-3


def test_a_trajectory_that_begins_elsewhere_is_refused_and_moves_nothing(lab: Any) -> None:
    driven = Driven(lab)
    driven.hear(point(0, driven.home + 0.1), point(1, driven.home))
    driven.mover.hear(b"\x00\x01\x00\x00", ATTACHMENT, 0)
    driven.mover.hear(JointTrajectory().encode(), None, 0)
    driven.cell.run(0.2)
    assert driven.mover.counters == {
        "trajectories": 1, "refused": 3, "refused_malformed": 1, "refused_attachment": 1, "refused_start": 1,
    }  # fmt: skip
    last = "fr: a trajectory was refused: points[0].positions, a1, is 0.1 rad from the robot's setpoint"
    assert driven.said[-1][0].startswith(last)
    np.testing.assert_allclose(driven.cell.q, driven.home, atol=1e-6)


@pytest.mark.long
def test_a_gantry_is_moved_in_metres_and_radians(lab: Any) -> None:
    driven = Driven(lab, "gr")
    goal = driven.home + np.array([0.1, -0.05, 0.02, 0.1, 0, 0, 0, 0, 0.1])
    driven.hear(point(1.0, goal, np.zeros(9)))
    driven.cell.run(1.5)
    assert driven.endings == ["arrived"]
    np.testing.assert_allclose(driven.cell.q, goal, atol=1e-6)
    assert driven.off_path() < 1e-4


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_any_trajectory_within_the_limits_is_driven_on_its_path_without_a_word_of_the_gate(
    lab: Any, seed: int
) -> None:
    driven, rng = Driven(lab), np.random.default_rng(seed)
    count = int(rng.integers(2, 8))
    times_s = np.cumsum(rng.uniform(0.2, 0.8, count))
    q = driven.home + np.clip(np.cumsum(rng.uniform(-0.15, 0.15, (count, 6)), axis=0), -0.3, 0.3)
    v = rng.uniform(-0.3, 0.3, (count, 6)) * (np.arange(count) < count - 1)[:, None]
    has_velocities = rng.random(count) < (0.0, 0.5, 1.0)[seed % 3]
    driven.hear(
        *(point(t, a, b if has else ()) for t, a, b, has in zip(times_s, q, v, has_velocities, strict=True))
    )
    driven.cell.run(float(times_s[-1]) + 1.0)
    assert driven.endings == ["arrived"]
    assert set(driven.cell.verdicts) == {"admitted"}
    assert driven.off_path() < 1e-3
    assert driven.kept()


def test_a_robot_that_left_its_path_is_not_brought_back() -> None:
    cell = small_cell()
    arm = robot_summary(cell.robots["fr"], cell.cycle_s)
    said: list[str] = []
    mover = TrajectoryMover("fr", arm, cell.cycle_s, lambda text, _: said.append(text))
    mover.hear(trajectory(arm.joints, point(2, [0.5] * 6)).encode(), ATTACHMENT, 0)
    here, away = np.full(6, 0.1), np.array([0.1, 0.2, 0.1, 0.1, 0.1, 0.1])
    for cycle, q in enumerate((here, here, away, away)):
        dq = mover.increment(_state(cycle, q), View(RobotView(cycle, 0.0, q, q)))
    assert said[-1] == "fr: the trajectory has ended: the robot has left its path"
    assert not dq.any()


def test_a_trajectory_begins_when_the_robot_rests_and_not_before() -> None:
    cell = small_cell()
    arm = robot_summary(cell.robots["fr"], cell.cycle_s)
    said: list[str] = []
    mover = TrajectoryMover("fr", arm, cell.cycle_s, lambda text, _: said.append(text))
    mover.hear(trajectory(arm.joints, point(0, [0.1] * 6), point(1, [0.3] * 6)).encode(), ATTACHMENT, 0)
    for cycle, q in enumerate((0.3, 0.2, 0.1)):  # the brake of another client
        joints = np.full(6, q)
        assert not mover.increment(_state(cycle, joints), View(RobotView(cycle, 0.0, joints, joints))).any()
    assert mover.increment(_state(3, joints), View(RobotView(3, 0.0, joints, joints))).all()
    assert len(said) == 1


def _state(cycle: int, q: Array) -> RobotState:
    joints = tuple(q.tolist())
    return RobotState(
        robot="fr", cycle=cycle, ipoc=0, time_s=0.0, q=joints, q_cmd=joints, tool=tool_pose("fr", joints),
        phase=Phase.ENGAGED,
    )  # fmt: skip
