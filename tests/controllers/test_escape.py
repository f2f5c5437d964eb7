"""The escape from an attacker: its model of both robots, what an attacker is after, and what comes of it."""

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.anatomy import placed_at_first
from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.error import look, view_jacobians
from deltaq_controllers.camera.escape.arm import EscapingArm, arm_of, clearance, place_boxes
from deltaq_controllers.camera.escape.follower import EscapePlan, EscapingFollower, Pursuit
from deltaq_controllers.camera.escape.motion import SimulatedView, move
from deltaq_controllers.camera.escape.rollout import (
    LENS,
    NOTHING,
    Attacker,
    Courses,
    CourseStart,
    EscapeGains,
    Simulation,
    best_course,
    course_cost,
)
from deltaq_controllers.camera.qp_follower import QpFollower
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.kinematics import Kinematics
from deltaq_controllers.leader.attacking import HomingStick
from deltaq_controllers.redundancy import damped_rates
from deltaq_controllers.surroundings.barriers import RESERVE
from deltaq_experiments import collision
from deltaq_experiments.options import Options
from deltaq_protocol.arrays import Array

LAB = CellModel.load("lab")
SCENE = Scene(LAB, "fr", "gr")
FR, GR = LAB.robots["fr"], LAB.robots["gr"]
FOCUS = np.array(GR.forward(GR.home)[:3, 3])
GAINS = EscapeGains()
CYCLE_S = 0.012
# arrays that may be written to, as everywhere else: for others all of the escape would be compiled once more
STAY = Courses(np.array([FR.home]), np.array([GAINS.steps]), np.array([FR.home]))


@pytest.fixture(scope="module")
def arm() -> EscapingArm:
    return arm_of(SCENE)


def at_the_lens() -> Attacker:
    """Balls before the lens, on their way to it."""
    lens = FR.camera_pose(FR.home)[:3, 3]
    tip = lens + 0.5 * (FOCUS - lens)
    toward = 0.75 * (lens - tip) / np.linalg.norm(lens - tip)
    above = np.array([0.0, 0.0, 0.3])
    return Attacker(np.array([tip, tip + above]), np.array([0.1, 0.2]), tip, toward, 0.75, LENS)


def start() -> CourseStart:
    return CourseStart(np.array(FR.home), np.zeros(FR.n), FOCUS, 1.25)


def test_a_candidate_trajectory_leads_the_joints_that_position_the_camera(arm: EscapingArm) -> None:
    assert arm.leads.tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    assert arm.sees.all()


def test_the_model_places_joints_like_the_robot(arm: EscapingArm) -> None:
    placed, random = placed_at_first(arm.boxed.anatomy), np.random.default_rng(3)
    for _ in range(5):
        q = random.uniform(FR.lower, FR.upper)
        place_boxes(arm.boxed, placed, q)
        assert placed.translation == pytest.approx(FR.joint_origins(q), abs=1e-9)


def test_a_simulated_step_agrees_with_the_law_and_the_view_of_the_other_controllers(arm: EscapingArm) -> None:
    placed, seen, camera = (
        placed_at_first(arm.boxed.anatomy),
        SimulatedView.of(FR.n),
        Kinematics(FR, "camera"),
    )
    random, time_s, held = np.random.default_rng(6), 0.08, 0
    for _ in range(50):
        before, rates = random.uniform(FR.lower, FR.upper), random.uniform(-0.3, 0.3, FR.n)
        goal, q, focus = random.uniform(FR.lower, FR.upper), before.copy(), random.uniform(-2.0, 2.0, 3)
        change = FR.max_acceleration * time_s
        way = goal - q
        toward = np.sign(way) * np.minimum(FR.max_velocity, np.sqrt(1.4 * FR.max_acceleration * np.abs(way)))
        wanted = np.clip(arm.leads * toward, rates - change, rates + change)
        place_boxes(arm.boxed, placed, q)
        angle, distance = move(arm, time_s, focus, goal, q, rates, seen, placed)
        camera.update(before)
        view = look(camera.rotation, camera.position, focus)
        assert (angle, distance) == pytest.approx((view.angle, view.distance), abs=1e-9)
        assert seen.lens == pytest.approx(camera.position, abs=1e-9)
        rows = view_jacobians(view, camera.position, focus, camera.twists)[0] / view.stretch
        assert seen.rows == pytest.approx(rows, abs=1e-9)
        weights = FR.max_acceleration**2
        turn = -0.5 / time_s * min(view.angle, 1.0) * view.direction
        free = damped_rates(rows, weights, turn, wanted / weights, 1.0)
        most = 1.6 * FR.max_acceleration
        fastest = np.minimum(np.sqrt(most * (FR.upper - before)), FR.max_velocity)
        slowest = -np.minimum(np.sqrt(most * (before - FR.lower)), FR.max_velocity)
        bounded = np.clip(free, slowest, fastest)
        stuck = bounded != free
        held += bool(stuck.any())
        if stuck.any():
            weights = np.where(stuck, 1e-6, weights)
            rest = damped_rates(rows, weights, turn, np.where(stuck, bounded, wanted) / weights, 1.0)
            bounded = np.clip(rest, slowest, fastest)
        assert rates == pytest.approx(bounded, abs=1e-6)
        assert q == pytest.approx(np.clip(before + time_s * bounded, FR.lower, FR.upper), abs=1e-7)
    assert 0 < held < 50


def test_no_clearance_is_greater_than_that_of_the_bodies(arm: EscapingArm) -> None:
    placed, random = placed_at_first(arm.boxed.anatomy), np.random.default_rng(4)
    geometry, data = FR.geometry, FR.model.createData()
    ball = pin.hppfcl.Sphere(0.1)
    for _ in range(10):
        q = random.uniform(FR.lower, FR.upper)
        centre = random.uniform((-1.5, -1.0, 0.0), (1.5, 2.0, 3.0))
        place_boxes(arm.boxed, placed, q)
        told = clearance(arm.boxed, arm.boxed.own, placed, centre[None], np.array([0.1]), np.zeros(3), 5.0)
        pin.forwardKinematics(FR.model, data, q)
        at = pin.hppfcl.Transform3s(np.eye(3), centre)
        least = math.inf
        for body in geometry.geometryObjects:
            where = data.oMi[body.parentJoint] * body.placement
            result = pin.hppfcl.DistanceResult()
            body_at = pin.hppfcl.Transform3s(where.rotation, where.translation)
            least = min(
                least,
                pin.hppfcl.distance(body.geometry, body_at, ball, at, pin.hppfcl.DistanceRequest(), result),
            )
        assert told <= max(least, 0.0) + 1e-6
        assert told > least - 0.5, "and not without bound less"


def test_the_best_of_several_candidates_costs_the_same_alone_and_less_than_the_others(
    arm: EscapingArm,
) -> None:
    random = np.random.default_rng(5)
    goals = random.uniform(FR.lower, FR.upper, (6, FR.n))
    goals[0] = FR.home
    courses = Courses(goals, np.full(6, 10), goals[::-1].copy())
    simulation, other = Simulation.of(arm, GAINS), Simulation.of(arm, GAINS)
    best, _, cost = best_course(arm, at_the_lens(), GAINS, start(), courses, simulation)
    alone = [course_cost(arm, at_the_lens(), GAINS, start(), courses, k, other, math.inf) for k in range(6)]
    assert cost == alone[best]
    assert cost <= min(alone) / GAINS.better + 0.05
    assert (simulation.best >= FR.lower - 1e-9).all()
    assert (simulation.best <= FR.upper + 1e-9).all()
    fastest = np.abs(np.diff(simulation.best, axis=0)).max(axis=0)
    assert (fastest <= FR.max_velocity * GAINS.step_s + 1e-9).all()


def past_the_lens(speed: float) -> Attacker:
    """A ball on the lens that goes away along the view axis, after nothing."""
    lens = np.array(FR.camera_pose(FR.home)[:3, 3])
    away = speed * (FOCUS - lens) / np.linalg.norm(FOCUS - lens)
    return Attacker(lens[None], np.array([0.3]), lens, away, speed, NOTHING)


def test_the_cost_of_a_contact_persists_for_the_rest_of_a_candidate(arm: EscapingArm) -> None:
    none = GAINS._replace(contact=0.0)
    costs = [
        course_cost(arm, past_the_lens(2.0), gains, start(), STAY, 0, Simulation.of(arm, gains), math.inf)
        for gains in (GAINS, none)
    ]
    assert costs[0] == pytest.approx(costs[1] + GAINS.contact * GAINS.steps)


def test_an_attacker_near_the_base_costs_at_the_end(arm: EscapingArm) -> None:
    assert sorted(arm.boxed.anatomy.carrier[arm.boxed.inner]) == [-1, 0], "the base and the first link"
    shoulder, extra = FR.joint_origins(FR.home)[1], []
    for metres in (0.6, 3.0):
        above = shoulder + np.array([0.0, 0.0, metres])
        attacker = Attacker(above[None], np.array([0.1]), above, np.zeros(3), 0.1, NOTHING)
        costs = [
            course_cost(arm, attacker, gains, start(), STAY, 0, Simulation.of(arm, gains), math.inf)
            for gains in (GAINS, GAINS._replace(inner=0.0))
        ]
        extra.append(costs[0] - costs[1])
    assert 0.0 < extra[0] < GAINS.inner
    assert extra[1] == 0.0


def test_a_plan_gets_better_and_two_plans_of_the_same_views_are_the_same(arm: EscapingArm) -> None:
    plans = [EscapePlan(arm, GAINS, CYCLE_S) for _ in range(2)]
    costs = []
    for _ in range(20):
        rates = [plan.rates(at_the_lens(), start()) for plan in plans]
        assert (rates[0] == rates[1]).all()
        costs.append(plans[0].cost)
    assert costs[-1] < 0.5 * costs[0]


class Moving:
    """A robot at its home whose joints move."""

    def __init__(self, q: Array, velocity: Array) -> None:
        self._q, self.velocity = q, velocity

    def ahead(self) -> Array:
        return self._q


@pytest.mark.parametrize("target", [LENS, 2])
def test_a_tools_target_is_inferred_from_its_path(target: int) -> None:
    joints, lens = FR.joint_origins(FR.home), FR.camera_pose(FR.home)[:3, 3]
    point = lens if target == LENS else joints[target]
    pursuit = Pursuit(SCENE)
    tool = GR.forward(GR.home)[:3, 3]
    # the gantry's axes point west, south and up
    velocity = np.zeros(GR.n)
    velocity[:3] = 0.5 * (point - tool) / np.linalg.norm(point - tool) * [-1.0, -1.0, 1.0]
    still, moving = Moving(np.array(GR.home), np.zeros(GR.n)), Moving(np.array(GR.home), velocity)
    assert pursuit.update(still, joints, lens).target == NOTHING  # type: ignore[arg-type]
    for _ in range(30):
        attacker = pursuit.update(moving, joints, lens)  # type: ignore[arg-type]
    assert attacker.target == target
    assert attacker.speed == pytest.approx(0.5)


@pytest.mark.parametrize("target", [LENS, 2])
def test_an_evaded_tool_still_pursues_the_same_point(target: int) -> None:
    joints, lens = FR.joint_origins(FR.home), FR.camera_pose(FR.home)[:3, 3]
    points, pursued = np.vstack([lens, joints]), target - LENS
    pursuit, stick, q = Pursuit(SCENE), HomingStick(0.5, CYCLE_S), np.array(GR.home)
    told = []
    for cycle in range(240):
        if (
            cycle == 80
        ):  # as far behind the tool's home as it was in front, and the others stay where they are
            points[pursued] += 2.0 * (GR.forward(GR.home)[:3, 3] - points[pursued])
        stick.point = points[pursued]
        velocity = np.zeros(GR.n)
        velocity[:3] = stick.update(GR.forward(q)[:3, 3]) * [-1.0, -1.0, 1.0]
        attacker = pursuit.update(Moving(q, velocity), points[1:], points[0])  # type: ignore[arg-type]
        q = q + CYCLE_S * velocity
        told.append(attacker.target)
    assert told[60:] == [target] * 180


def test_a_tool_that_moves_elsewhere_pursues_nothing_and_a_slowed_one_its_point() -> None:
    joints, lens = FR.joint_origins(FR.home), FR.camera_pose(FR.home)[:3, 3]
    tool = GR.forward(GR.home)[:3, 3]
    away = tool + 5.0 * np.cross(lens - tool, [0.0, 0.0, 1.0])
    told = {}
    # the limits of its joints leave a tool half of its speed along one axis
    for name, point, slow in (("away", away, 1.0), ("slowed", joints[2], 0.5)):
        pursuit, stick, q = Pursuit(SCENE), HomingStick(0.5, CYCLE_S), np.array(GR.home)
        for _ in range(120):
            stick.point = point
            velocity = np.zeros(GR.n)
            velocity[:3] = stick.update(GR.forward(q)[:3, 3]) * [-1.0, -slow, 1.0]
            told[name] = pursuit.update(Moving(q, velocity), joints, lens).target  # type: ignore[arg-type]
            q = q + CYCLE_S * velocity
    assert told == {"away": NOTHING, "slowed": 2}


@pytest.mark.long
def test_each_led_joint_moves_as_its_candidate_trajectory(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = np.array([0.1, -0.3, 0.1, 0.0, 0.0, 0.0])

    def in_danger(plan: EscapePlan, _attacker: Attacker, _start: CourseStart) -> Array:
        plan.cost = 2.0 * GAINS.acts_above
        return wanted

    follower = EscapingFollower(SCENE, 1.25, FOCUS)
    monkeypatch.setattr(EscapePlan, "rates", in_danger)
    q, leader = np.array(FR.home), np.array(GR.home)
    for cycle in range(40):
        now = CYCLE_S * cycle
        dq = follower.increment(
            View(RobotView(cycle, now, q, q), {"gr": RobotView(cycle, now, leader, leader)})
        )
        q = q + dq
    assert dq[:3] == pytest.approx(CYCLE_S * wanted[:3], rel=0.05)


@pytest.mark.long
def test_a_leading_candidate_includes_the_braking_distance_of_the_other_robot() -> None:
    lens, tool = FR.camera_pose(FR.home)[:3, 3], GR.forward(GR.home)[:3, 3]
    toward = (lens - tool) / np.linalg.norm(lens - tool)
    reserve = {}
    for make in (QpFollower, EscapingFollower):
        follower, q, leader = make(SCENE, 1.25, FOCUS), np.array(FR.home), np.array(GR.home)
        leader[:3] += (lens - 0.5 * toward - tool) * [-1.0, -1.0, 1.0]
        slack = 0.0
        for cycle in range(30):
            now = CYCLE_S * cycle
            view = View(RobotView(cycle, now, q, q), {"gr": RobotView(cycle, now, leader, leader)})
            q = q + follower.increment(view)
            leader[:3] += 0.75 * CYCLE_S * toward * [-1.0, -1.0, 1.0]
            slack += float(follower.slack_m[RESERVE])
        reserve[make] = slack
    assert reserve[QpFollower] > 0.0
    assert reserve[EscapingFollower] == 0.0


@pytest.mark.long
def test_without_robots_in_the_way_the_increments_are_those_of_qp() -> None:
    followers = [make(SCENE, 1.25, FOCUS) for make in (QpFollower, EscapingFollower)]
    q = np.array(FR.home)
    for cycle in range(5):
        own, leader = (
            RobotView(cycle, CYCLE_S * cycle, q, q),
            RobotView(cycle, CYCLE_S * cycle, GR.home, GR.home),
        )
        one, other = (follower.increment(View(own, {"gr": leader})) for follower in followers)
        assert (one == other).all()
        q = q + one


@pytest.mark.nightly
def test_an_attack_on_the_elbow_hits_qp_and_misses_escape() -> None:
    options = Options(
        leader_speed_m_s=0.5, target="elbow", gated=False, duration_s=6.0, settle_s=1.0, seed=104
    )
    contacts = {}
    for controller in ("qp", "escape"):
        report = collision.run(replace(options, controller=controller)).report
        assert isinstance(report, collision.CollisionReport)
        assert sum(report.limits.model_dump().values()) == 0
        contacts[controller] = report.contacts
    assert contacts["qp"] > 0
    assert contacts["escape"] == 0
