"""Tasks as data: bad files are refused, and advisor and `coupled` use the axes that a task leaves free."""

from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_cell.problems import CellError
from deltaq_controllers.advisor.advisor import Option, advise
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import AdvisorProblem
from deltaq_controllers.advisor.session import AdvisorSession, SynchronousAdvisor
from deltaq_controllers.criteria import BY_NAME, Postures, RobotData
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.inverse.tracking import ConstraintTracker
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.hand_modes import CoupledMode, weighed
from deltaq_controllers.modes.interface import Limit
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.task import AXES, HandTask, Region, Task, TaskError, Tolerance, load_task, shipped
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, Grip, OperatorCommand

CYCLE_S = 0.012
LAB, DAWM = CellModel.load("lab"), CellModel.load("dawm")
FR = LAB.robots["fr"]
SLANT, ROLL = {"rx_deg": 15.0, "z_m": 0.05}, {"rz_deg": 180.0, "z_m": 0.05}
HOME = np.array(FR.home)


def tool(**tolerance: float) -> Task:
    return Task(hands={"tool": HandTask(tolerance=Tolerance(**tolerance))}, weights={"travel": 1.0})


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "hands: {tool: {tolerance: {roll_deg: free}}}",
            "roll_deg: not a field here; did you mean 'rz_deg'?",
        ),
        ("hands: {tool: {tolerance: {rz_deg: -5}}}", "rz_deg: should be greater than or equal to 0, got -5"),
        ("hands: {tool: {tolerance: {rz_deg: frei}}}", "rz_deg: should be a valid number, got 'frei'"),
        ("hands: {tool: {tolerance: {x_m: .nan}}}", "x_m: should be a finite number"),
        (
            "hands: {tool: {tolerance: {rx_deg: free, ry_deg: 90}}}",
            "only one turn may be wider than 80 deg; rx_deg and ry_deg are",
        ),
        (
            "hands: {tool: {motion: [0, 0, 0]}}",
            "hands.tool: motion must have a length above 0, got [0.0, 0.0, 0.0]",
        ),
        (
            "hands: {tool: {region: {lower_m: [1, 0, 0], upper_m: [1, 1, 1]}}}",
            "hands.tool.region: x: lower_m 1 must be below upper_m 1",
        ),
        ("weights: {travel: 0, force: 0}", "weights: one at least must be above 0"),
        ("weights: {}", "weights: one at least must be above 0"),
        ("weights: {travel: -1}", "weights.travel: should be greater than or equal to 0, got -1"),
        ("dwell_s: -1", "dwell_s: should be greater than or equal to 0, got -1"),
        ("hands: {tool", "not YAML"),
        ("", "should be an object"),
    ],
)
def test_a_bad_file_is_told_with_file_field_value_and_bound(tmp_path: Path, text: str, told: str) -> None:
    (file := tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(CellError, match=r"^bad\.yaml") as raised:
        load_task(file)
    assert told in str(raised.value)


@pytest.mark.parametrize(
    ("task", "told"),
    [
        (Task(robot="xy"), "robot: no 'xy' here; there are fr, gr"),
        (Task(hands={"tol": HandTask()}), "hands: no 'tol' here; there are tool; did you mean 'tool'?"),
        (Task(known=("flor",)), "known: no 'flor' here; .* did you mean 'floor'"),
        (
            Task(hands={"tool": HandTask(region=Region(lower_m=(5, 5, 5), upper_m=(6, 6, 6)))}),
            "hands.tool.region: the hand is outside: x is -0.011 m, not from 5 to 6 m",
        ),
    ],
)
def test_a_task_that_does_not_fit_the_cell_is_refused(task: Task, told: str) -> None:
    with pytest.raises(TaskError, match=told):
        session(task).ask(HOME, {}, lambda _: True, hands_may_leave=True)
    with pytest.raises(
        TaskError, match=r"no 'pegg' here; there are gauge, lever, peg, .*; did you mean 'peg'"
    ):
        load_task("pegg")


def session(task: Task) -> AdvisorSession:
    return AdvisorSession(LAB, "fr", task, options=4, effort=0.3)


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_task_fits_its_cell(name: str) -> None:
    task = load_task(name)
    cell = task.seen(DAWM if task.robot == "dawm" else LAB)
    robot, tracker = cell.robots[task.robot], ConstraintTracker(cell.robots[task.robot], task)
    problem = AdvisorProblem(cell, task.robot, tracker.hands(robot.home), tracker=tracker)
    assert problem.weights == task.weights
    assert problem.free == robot.n - 6 * len(robot.hands) + len(list(task.tolerances()))
    task.check_region(robot.hands, problem.poses)
    if task.known is not None:
        assert {body.name for body in cell.structure} == {f"structure/{name}" for name in task.known}


def test_tolerances_reproduce_any_pose_that_they_allow() -> None:
    random = np.random.default_rng(1)
    for cell, name, hand in ((LAB, "fr", "tool"), (LAB, "gr", "tool"), (DAWM, "dawm", "right")):
        for turns in (
            {"rz_deg": 180, "ry_deg": 40},
            {"ry_deg": 180, "x_m": 0.1},
            {"rx_deg": 180, "z_m": 0.1},
        ):
            tracker = ConstraintTracker(
                cell.robots[name], Task(hands={hand: HandTask(tolerance=Tolerance(**turns))})
            )
            q = random.uniform(tracker.robot.lower, tracker.robot.upper)
            places = tracker.hands(q)
            np.testing.assert_allclose(tracker.with_tolerances(q[: tracker.driven], places), q, atol=1e-12)
            (found,) = tracker.track(q[None, tracker.base], places, q)
            np.testing.assert_allclose(found, q, atol=1e-9)


@pytest.fixture(scope="module")
def options() -> list[Option]:
    tracker = ConstraintTracker(FR, tool(**ROLL))
    task = AdvisorProblem(LAB, "fr", tracker.hands(HOME), tracker=tracker)
    exact = ExactClearance(LAB, "fr")
    return advise(task, HOME, generator=np.random.default_rng(1), options=4, effort=0.5, exact=exact)


@pytest.mark.long
def test_an_arm_without_a_joint_to_spare_gets_options_within_the_tolerance(options: list[Option]) -> None:
    assert len(options) >= 3
    assert options[0].energy < options[0].energy_here - 0.001
    for option in options:
        assert option.path is not None
        for q in option.path[:: len(option.path) // 10 or 1]:
            assert_within(q, ROLL)


def assert_within(q: Array, tolerance: dict[str, float], slack: float = 1e-9) -> None:
    """The hand of fr is off its pose at home by no more than the tolerance, and not at all along other axes."""
    T = np.linalg.inv(FR.forward(q)) @ FR.forward(HOME)
    off = dict(zip(AXES, (*T[:3, 3], *np.rad2deg(pin.log3(T[:3, :3]))), strict=True))
    for axis, value in off.items():
        assert abs(value) <= tolerance.get(axis, 0.0) + (0.1 if axis in AXES[:3] else 1.0) * slack


@pytest.mark.long
def test_the_robot_drives_to_an_option_within_the_tolerance() -> None:
    advisor = SynchronousAdvisor(session(tool(**SLANT)))
    modes = {DrivingMode.ADVISOR: lambda robot: AdvisorMode(robot, CYCLE_S, advisor)}
    by_hand = Teleoperator(FR, CYCLE_S, DrivingMode.ADVISOR, modes=modes)
    by_hand.command, q = OperatorCommand(option=1), HOME
    for cycle in range(2000):
        q = q + by_hand.increment(View(RobotView(cycle, cycle * CYCLE_S, q, q)))
        assert_within(q, SLANT, 1e-3)
        if by_hand.arrived_at == 1:
            return
    pytest.fail("did not arrive")


def driven(task: Task, speed_m_s: float = 0.05, cycles: int = 200) -> tuple[Teleoperator, list[Array]]:
    """fr driven along x in `coupled`, and 40 cycles to come to rest."""
    criteria = (weighed(RobotData(LAB, "fr", task=task), task.weights or {}),)
    modes = {DrivingMode.COUPLED: partial(CoupledMode, criteria=criteria, task=task)}
    by_hand, way = Teleoperator(FR, CYCLE_S, DrivingMode.COUPLED, modes=modes), [HOME]
    for cycle in range(cycles + 40):
        by_hand.command = OperatorCommand({"x": speed_m_s} if cycle < cycles else {})
        view = View(RobotView(cycle, cycle * CYCLE_S, way[-1], way[-1]))
        way.append(way[-1] + by_hand.increment(view))
    return by_hand, way


def test_coupled_uses_what_is_free_and_keeps_what_is_not() -> None:
    fixed, (_, way) = driven(tool())[1][-1], driven(tool(rx_deg=5))
    travel = BY_NAME["travel"].value(Postures(RobotData(LAB, "fr"), np.array([fixed, way[-1]])))
    assert travel[1] < travel[0] - 0.001
    most = 0.0
    for q in way:
        turn = np.rad2deg(pin.log3(FR.forward(q)[:3, :3].T @ FR.forward(HOME)[:3, :3]))
        assert np.abs(turn[1:]).max() < 1e-4
        most = max(most, abs(float(turn[0])))
        moved = FR.forward(q)[:3, 3] - FR.forward(HOME)[:3, 3]
        assert np.abs(moved[1:]).max() < 1e-6
    assert 4.0 < most <= 5.0


def test_a_region_ends_the_motion_of_the_hand_and_dwelling_is_counted() -> None:
    x, y, z = FR.forward(HOME)[:3, 3]
    box = Region(lower_m=(x - 1, y - 1, z - 1), upper_m=(x + 0.05, y + 1, z + 1))
    task = Task(hands={"tool": HandTask(region=box)}, weights={"travel": 1.0}, dwell_s=0.2)
    by_hand, way = driven(task, 0.25)
    assert all(box.holds(FR.forward(q)[:3, 3]) for q in way)
    assert FR.forward(way[-1])[0, 3] > x + 0.04
    assert by_hand.status == "still for 0.2 of 0.2 s"
    by_hand.command = OperatorCommand({"x": 0.1})
    by_hand.increment(View(RobotView(999, 99.0, way[-1], way[-1])))
    assert by_hand.limitation is not None
    assert (by_hand.limitation.limit, by_hand.limitation.what) == (Limit.WORKSPACE_EDGE, "tool")


@pytest.mark.long
def test_hands_that_hold_an_object_do_not_slip_on_it_within_a_tolerance() -> None:
    robot, task = DAWM.robots["dawm"], load_task("valve")
    criteria = (weighed(RobotData(DAWM, "dawm", task=task), {"travel": 1.0}),)
    modes = {DrivingMode.COUPLED: partial(CoupledMode, criteria=criteria, task=task)}
    by_hand, q, held = (
        Teleoperator(robot, CYCLE_S, DrivingMode.COUPLED, modes=modes),
        np.array(robot.home),
        [],
    )
    for cycle in range(220):
        rates = {"z": 0.05} if cycle < 60 or 130 < cycle < 200 else {}
        by_hand.command = OperatorCommand(rates, grip=Grip.OBJECT if cycle > 90 else None)
        q = q + by_hand.increment(View(RobotView(cycle, cycle * CYCLE_S, q, q)))
        if cycle > 120:
            held.append(np.linalg.inv(robot.forward(q, "left")) @ robot.forward(q, "right"))
    assert by_hand.grip is Grip.OBJECT
    assert np.abs(np.array(held) - held[0]).max() < 2e-4


def test_forces_and_directions_replace_the_worst_ones() -> None:
    plain, turned = RobotData(LAB, "fr"), np.eye(3)
    worst = {
        name: BY_NAME[name].value(Postures(plain, HOME))[0] for name in ("speed", "force", "deformation")
    }
    found: dict[str, list[float]] = {name: [] for name in worst}
    for axis in turned.tolist():
        needs = HandTask(force_n=tuple(10.0 * part for part in axis), motion=tuple(axis))
        data = RobotData(LAB, "fr", task=Task(hands={"tool": needs}))
        for name in worst:
            found[name].append(float(BY_NAME[name].value(Postures(data, HOME))[0]))
        # virtual work: the torques of the force are J^T f
        J, R = FR.jacobian(HOME)[:3], FR.forward(HOME)[:3, :3]
        load = (Postures(plain, HOME).gravity[0] + J.T @ (R @ (10.0 * np.array(axis)))) / plain.torques
        assert BY_NAME["torque"].value(Postures(data, HOME))[0] == pytest.approx(np.square(load).mean())
    assert min(found["speed"]) >= worst["speed"] - 1e-9
    assert min(found["force"]) >= worst["force"] - 1e-9
    assert max(found["deformation"]) <= worst["deformation"] + 1e-12
    # of K^-1 the diagonal in any axes has the trace's sum
    assert np.mean(found["deformation"]) == pytest.approx(
        BY_NAME["compliance"].value(Postures(plain, HOME))[0]
    )
