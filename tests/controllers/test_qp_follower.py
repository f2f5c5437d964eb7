"""The quadratic programme as a follower, in a closed loop of plain kinematics: 12 ms cycle, 60 ms latency."""

from typing import Any

import numpy as np
import pytest
from closed_loop import CYCLE_S, Servo, lab, limit_violations, with_camera

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import Camera, Pose
from deltaq_cell.models import RobotModelError
from deltaq_controllers.camera.controllers import NAMES, camera_controller_named
from deltaq_controllers.camera.qp_follower import QpFollower
from deltaq_controllers.camera.qp_problem import QpGains
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.leader.attacking import AttackingLeader
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_controllers.surroundings.barriers import STANDING, Barriers
from deltaq_protocol.arrays import Array


def follower(
    cell: CellModel | None = None, focus: Array | None = None, distance_m: float = 1.25
) -> QpFollower:
    return QpFollower(Scene(cell or lab(), "fr", "gr"), distance_m, focus)


def look_at(controller: QpFollower, q: Array, duration_s: float) -> tuple[Array, int]:
    """(k, 2) angle [deg] and distance error [m] while the leader stands at home."""
    q_leader, robot = lab().robots["gr"].home, controller._scene.robot
    q, dq_last, seen, violations = q.copy(), np.zeros(robot.n), [], 0
    for cycle in range(round(duration_s / CYCLE_S)):
        time_s = cycle * CYCLE_S
        seen.append(controller.errors(q, q_leader))
        others = {"gr": RobotView(cycle, time_s, q_leader, q_leader)}
        dq = controller.increment(View(RobotView(cycle, time_s, q, q), others))
        violations += limit_violations(robot, q, dq, dq_last)
        q, dq_last = q + dq, dq
    return np.array(seen) * [180.0 / np.pi, 1.0], violations


def follow(
    controller: QpFollower,
    leader: ScriptedLeader | AttackingLeader,
    duration_s: float,
    delay_cycles: int = 2,
) -> tuple[Array, int]:
    """(k, 3) the same and the clearance [m] while the leader moves about, and the drives of both lag."""
    cell = lab()
    q, q_leader = np.array(cell.robots["fr"].home), np.array(cell.robots["gr"].home)
    servo, leaders_servo, dq_last, violations = Servo(q), Servo(q_leader), np.zeros(6), 0
    known: list[RobotView] = []
    seen: list[tuple[float, float, float]] = []
    for cycle in range(round(duration_s / CYCLE_S)):
        time_s = cycle * CYCLE_S
        own = RobotView(cycle, time_s, servo.q.copy(), q)
        q_leader = q_leader + leader.increment(
            View(RobotView(cycle, time_s, q_leader, q_leader), {"fr": own})
        )
        measured = leaders_servo.follow(q_leader).copy()
        known.append(RobotView(cycle, time_s, measured, q_leader))
        old = known[max(0, len(known) - 1 - delay_cycles)]
        dq = controller.increment(View(own, {"gr": old}))
        violations += limit_violations(cell.robots["fr"], q, dq, dq_last)
        q, dq_last = q + dq, dq
        servo.follow(q)
        angle, distance = controller.errors(servo.q, measured)
        seen.append((float(np.rad2deg(angle)), distance, controller.clearance(servo.q, measured)))
    assert controller.unsolved == 0
    return np.array(seen), violations


def attack(duration_s: float, seed: int = 0, gains: QpGains | None = None) -> Array:
    """(k, 3) the same while the leader attacks the lens at 0.75 m/s, with no gate to stop it."""
    robots = lab().robots
    focus = robots["gr"].forward(robots["gr"].home)[:3, 3]
    controller = QpFollower(Scene(lab(), "fr", "gr"), 1.25, focus, gains)
    leader = AttackingLeader(robots["gr"], robots["fr"], CYCLE_S, 0.75, seed)
    seen, violations = follow(controller, leader, duration_s)
    assert violations == 0
    return seen


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(("speed_m_s", "angle_deg", "distance_m"), [(0.25, 0.5, 0.01), (1.0, 1.1, 0.08)])
def test_the_leader_is_kept_in_view(speed_m_s: float, angle_deg: float, distance_m: float) -> None:
    leader = ScriptedLeader(lab().robots["gr"], CYCLE_S, speed_m_s, 0)
    seen, violations = follow(follower(), leader, 12.0)
    settled = np.abs(seen[round(5.0 / CYCLE_S) :])
    assert violations == 0
    assert settled[:, 0].max() <= angle_deg
    assert settled[:, 1].max() <= distance_m


def test_from_exactly_behind_the_camera_turns_round_within_limits() -> None:
    T = lab().robots["fr"].camera_pose(lab().robots["fr"].home)
    behind = T[:3, 3] - 1.25 * T[:3, 2]
    controller = follower(focus=behind)
    seen, violations = look_at(controller, lab().robots["fr"].home, 4.0)
    assert seen[0, 0] == pytest.approx(180.0)
    assert violations == 0
    assert seen[-1, 0] < 0.1


def test_a_joint_that_reaches_its_limit_stops_without_the_others() -> None:
    # A3 ends at its limit while A1 is fast and takes long to brake: the rest of the arm has to go on
    start = np.deg2rad([-121.7, -52.6, -82.3, 280.8, 72.4, 58.4])
    seen, violations = look_at(follower(), start, 1.0)
    angle = seen[:, 0]
    assert angle[0] > 140.0
    assert violations == 0
    assert (np.diff(angle) < 0.01).all()
    assert angle[round(0.6 / CYCLE_S)] < 1.0


@pytest.mark.long
@pytest.mark.parametrize("offset_m", [(0.06, 0.0, 0.17), (0.0, -0.1, 0.2)])
def test_a_camera_off_the_last_axis_ends_level_and_aimed(offset_m: tuple[float, float, float]) -> None:
    camera = Camera(pose=Pose(position_m=offset_m, rpy_deg=(0, 0, 180)), vertical_view_deg=45)
    robots = {"fr": with_camera(camera), "gr": lab().robots["gr"]}
    cell = CellModel.of(lab().description, robots)
    controller = follower(cell)
    seen, violations = look_at(controller, robots["fr"].home, 4.0)
    assert violations == 0
    assert seen[-1, 0] < 0.01
    assert abs(seen[-1, 1]) < 1e-3


@pytest.mark.long
def test_it_keeps_its_distance_from_a_leader_that_approaches_the_lens() -> None:
    cell = lab()
    q, dq_last = np.array(cell.robots["fr"].home), np.zeros(6)
    controller = follower(focus=cell.robots["gr"].forward(cell.robots["gr"].home)[:3, 3])
    q_leader, least = np.array(cell.robots["gr"].home), np.inf
    for cycle in range(round(5.0 / CYCLE_S)):
        lens = cell.robots["fr"].camera_pose(q)[:3, 3]
        way = lens - cell.robots["gr"].forward(q_leader)[:3, 3]
        speed = 0.25 * way / max(float(np.linalg.norm(way)), 1e-6)
        # the gantry's joints move the tool as it stands: -x, -y, +z
        q_leader[:3] += CYCLE_S * speed * [-1.0, -1.0, 1.0]
        view = View(
            RobotView(cycle, cycle * CYCLE_S, q, q),
            {"gr": RobotView(cycle, cycle * CYCLE_S, q_leader.copy(), q_leader.copy())},
        )
        dq = controller.increment(view)
        assert limit_violations(cell.robots["fr"], q, dq, dq_last) == 0
        q, dq_last = q + dq, dq
        least = min(least, controller.clearance(q, q_leader))
    assert least >= controller.barrier_m - 0.01
    assert np.rad2deg(controller.errors(q, q_leader)[0]) < 1.0


@pytest.mark.long
def test_a_persistent_attacker_does_not_corner_the_camera() -> None:
    # two attacks: who only backs away has A1 at its limit and the arm stretched out in both of them
    angle_deg, _, clearance_m = attack(13.5, seed=4).T
    assert angle_deg[round(1.0 / CYCLE_S) :].max() < 1.0
    assert clearance_m.min() > 0.15
    assert clearance_m.min() < 0.3, "it did come near"


@pytest.mark.long
def test_the_braking_distance_of_others_gives_way_to_the_view() -> None:
    cornered = QpGains(room_weight=0.0, posture_weight=0.0)
    kept = attack(2.2, gains=cornered._replace(reserve_price=cornered.barrier_price))
    given = attack(2.2, gains=cornered)
    assert given[80:, 0].max() < 0.6 * kept[80:, 0].max()
    assert given[:, 2].min() > 0.1, "of the distance to be kept nothing is given"


class BarriersSeen(QpFollower):
    """A follower that keeps the barriers of its last increment."""

    def _barriers(self, *args: Any) -> Barriers:
        self.barriers = super()._barriers(*args)
        return self.barriers


def test_for_any_focus_the_arm_keeps_its_distance_from_itself() -> None:
    """Else the gate holds the whole arm for as long as the camera wants to turn."""
    cell, random, close = lab(), np.random.default_rng(0), 0
    robot, home = cell.robots["fr"], cell.robots["gr"].home
    controller = BarriersSeen(Scene(cell, "fr", "gr"), 1.25, np.zeros(3))
    for cycle in range(1500):
        q = robot.lower + random.uniform(0.03, 0.97, robot.n) * (robot.upper - robot.lower)
        controller.focus = random.uniform((-2.0, -2.0, 0.2), (2.0, 2.0, 2.0))
        at_rest = RobotView(cycle, cycle * CYCLE_S, q, q, dq=np.zeros(robot.n))
        controller.increment(View(at_rest, {"gr": RobotView(cycle, cycle * CYCLE_S, home, home)}))
        barriers = controller.barriers
        missing_m = barriers.least[barriers.kinds == STANDING].max(initial=0.0)
        if missing_m > 0.0:
            close += 1
            assert controller.slack_m[STANDING] <= missing_m, "to stay where it is would leave more"
    assert close > 100


class Zooming(QpFollower):
    """Asked to come nearer after four seconds; notes how near to a limit a joint gets then, as a share of its range."""

    least_margin = 1.0

    def increment(self, view: View) -> Array:
        robot, q = self._scene.robot, view.own.q_cmd
        if view.own.time_s > 4.0:
            self.desired_distance_m = 1.0
            margin = np.minimum(q - robot.lower, robot.upper - q) / (robot.upper - robot.lower)
            self.least_margin = min(self.least_margin, float(margin.min()))
        return super().increment(view)


@pytest.mark.long
def test_free_joints_do_not_drift_into_a_limit() -> None:
    # at its limits A3 or A5 would leave no way back to a greater distance
    controller = Zooming(Scene(lab(), "fr", "gr"), 1.25)
    leader = ScriptedLeader(lab().robots["gr"], CYCLE_S, 0.25, seed=2)
    seen, violations = follow(controller, leader, 11.0)
    assert violations == 0
    assert controller.least_margin > 0.05
    assert np.abs(seen[round(10.0 / CYCLE_S) :, 1]).max() < 0.01


def test_without_near_robots_the_joint_margin_has_no_effect() -> None:
    q, q_leader = np.array(lab().robots["fr"].home), lab().robots["gr"].home
    q[0] = lab().robots["fr"].lower[0] + 0.1
    view = View(RobotView(0, 0.0, q, q), {"gr": RobotView(0, 0.0, q_leader, q_leader)})
    careless = QpFollower(Scene(lab(), "fr", "gr"), 1.25, gains=QpGains(room_weight=0.0))
    assert follower().clearance(q, q_leader) == follower().evades_below_m
    assert (follower().increment(view) == careless.increment(view)).all()


def test_it_comes_to_rest_before_the_leaders_first_state() -> None:
    q = np.array(lab().robots["fr"].home)
    dq = follower().increment(View(RobotView(0, 0.0, q, q)))
    assert (dq == 0.0).all()


def test_a_robot_without_a_camera_is_refused() -> None:
    with pytest.raises(RobotModelError, match="carries no camera"):
        QpFollower(Scene(lab(), "gr", "fr"), 1.25)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_makes_a_controller(name: str) -> None:
    controller = camera_controller_named(name, Scene(lab(), "fr", "gr"), 1.25)
    home, q_leader = lab().robots["fr"].home, lab().robots["gr"].home
    assert controller.errors(home, q_leader)[0] < np.deg2rad(
        2.0
    )  # home looks at the tool, 4 cm behind the aim
    assert controller.clearance(home, q_leader) > 0.3


@pytest.mark.parametrize(
    ("name", "said"), [("best", "there are paper"), ("no.such:thing", "cannot be imported")]
)
def test_an_unknown_name_is_refused(name: str, said: str) -> None:
    with pytest.raises(ControllerError, match=said):
        camera_controller_named(name, Scene(lab(), "fr", "gr"), 1.25)
