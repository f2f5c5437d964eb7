""""""

import numpy as np
import pinocchio as pin
import pytest
import seven_axes
from driving import CYCLE_S, PlainDrive, StackDrive, model

from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import LastIncrement, RobotView
from deltaq_controllers.modes.hands import Hands, displacement, turned
from deltaq_controllers.modes.interface import Limit, Motion, from_verdict
from deltaq_controllers.modes.teleoperator import Reflection, share_of
from deltaq_deploy.command.drive_display import bar
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.driving import TELEOPERATION, DrivingMode
from deltaq_protocol.messages import Outcome, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode

JOINT, DECOUPLED, SELF_MOTION, _, COUPLED = TELEOPERATION


@pytest.mark.long
def test_a_joint_at_its_limit_is_named() -> None:
    run = PlainDrive("gr", JOINT)
    assert run.drive(6.0, a1=0.5).limitations[-1] == Limit.JOINT_LIMIT
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert (limitation.what, limitation.text) == ("a1", "a1 is at its limit, 180.0°")
    assert run.drive(0.5, a1=-0.5).limitations[-1] == ""


def test_a_joint_at_its_greatest_speed_is_named() -> None:
    assert PlainDrive("gr", JOINT).drive(0.9, e1=-1.0).limitations[-1] == Limit.SPEED


@pytest.mark.long
def test_the_edge_of_the_workspace_is_named_and_the_hand_is_not_turned_there() -> None:
    run = PlainDrive("gr", DECOUPLED)
    start = run.now
    driven = run.drive(7.0, z=-0.2)
    assert driven.limitations[-1] == Limit.WORKSPACE_EDGE
    assert not run.dq_last.any() or np.abs(run.dq_last).max() < 1e-3
    assert driven.hand_errors(driven.q_cmd[-1:], start)[1] < 0.01


def wrist_stretched() -> np.ndarray:
    q = model("gr").home.copy()
    q[7] = np.deg2rad(1.0)  # a5
    return q


def test_a_wrist_singularity_is_named_only_in_the_lost_direction() -> None:
    lost = PlainDrive("gr", DECOUPLED, wrist_stretched())
    driven = lost.drive(0.5, **_about_the_lost_axis(lost))
    assert driven.limitations[-1] == Limit.SINGULARITY
    free = PlainDrive("gr", DECOUPLED, wrist_stretched())
    free.teleoperator.limitation = None
    _, lost_axis = _lost(free)
    turned = np.cross(lost_axis, [0.0, 0.0, 1.0])
    assert free.drive(0.3, rx=0.2 * turned[0], ry=0.2 * turned[1], rz=0.2 * turned[2]).limitations[-1] == ""


def _lost(run: PlainDrive) -> tuple[float, np.ndarray]:
    jacobian = run.robot.jacobian(run.now)[:, 3:]
    u, values, _ = np.linalg.svd(np.diag([1, 1, 1, 0.5, 0.5, 0.5]) @ jacobian)
    axis = u[3:, -1]
    return float(values[-1]), axis / np.linalg.norm(axis)


def _about_the_lost_axis(run: PlainDrive) -> dict[str, float]:
    x, y, z = (0.2 * _lost(run)[1]).tolist()
    return {"rx": x, "ry": y, "rz": z}


@pytest.mark.long
def test_joint_mode_leads_out_of_a_singularity_and_of_the_edge() -> None:
    stretched = PlainDrive("gr", DECOUPLED)
    stretched.drive(7.0, z=-0.2)
    for run in (stretched, PlainDrive("gr", DECOUPLED, wrist_stretched())):
        weak, _ = _lost(run)
        run.drive(1.0, JOINT)
        run.drive(2.0, a3=0.4, a5=0.4)
        assert _lost(run)[0] > weak + 0.07
        run.drive(1.0, DECOUPLED)
        assert run.drive(0.5, x=0.05).limitations[-1] == ""
        assert run.violations == 0


@pytest.mark.long
@pytest.mark.nightly
def test_a_hold_of_the_gate_is_named_and_joint_mode_leads_out() -> None:
    run = StackDrive("gr", COUPLED)
    held = run.drive(8.0, z=-0.3)
    assert held.limitations[-1] == Limit.CLEARANCE
    limitation = run.teleoperator.limitation
    assert limitation is not None
    assert "gr/" in limitation.what
    assert "mm" in limitation.text
    high = run.robot.forward(held.q_cmd[-1])[2, 3]
    run.drive(0.5, JOINT)
    out = run.drive(2.0, e3=0.1)
    assert out.verdicts[-1].outcome is Outcome.ADMITTED
    assert run.robot.forward(out.q_cmd[-1])[2, 3] > high + 0.1


def test_every_reason_of_the_gate_has_a_kind() -> None:
    for code in ReasonCode:
        verdict = Verdict(
            robot="gr", cycle=1, seq=1, outcome=Outcome.HELD, reasons=(Reason(code=code, what="a1"),)
        )
        found = from_verdict(verdict)
        assert found is not None
        assert found.text
    admitted = Verdict(robot="gr", cycle=1, seq=1, outcome=Outcome.ADMITTED)
    assert from_verdict(admitted) is None


# How much of what is asked for goes through, as an operator sees and feels it.


def verdict(outcome: Outcome, scale: float) -> Verdict:
    return Verdict(robot="gr", cycle=1, seq=1, outcome=outcome, scale=scale, dq=(0.0,) * 9)


@pytest.mark.long
def test_a_limit_is_reflected_and_an_acceleration_is_not() -> None:
    run = PlainDrive("gr", DrivingMode.JOINT)
    shares = []
    for _ in range(100):
        run.drive(CYCLE_S, e1=0.1)
        shares.append(run.teleoperator.reflection.share)
    assert min(shares) == 1.0
    run.drive(8.0, e1=0.5)
    assert "limit" in run.driven.limitations[-1]
    assert run.teleoperator.reflection.share < 0.01
    run.drive(1.0)
    assert run.teleoperator.reflection.share > 0.99, "nobody asks for anything"


@pytest.mark.long
def test_the_slow_down_of_a_hand_on_its_line_is_reported() -> None:
    run = PlainDrive("fr", DrivingMode.COUPLED)
    run.drive(0.5, x=-0.1)
    assert run.teleoperator.reflection.share > 0.99
    run.drive(6.0, x=-0.1)
    assert run.driven.limitations[-1]
    assert run.teleoperator.reflection.share < 0.05


@pytest.mark.parametrize(
    ("outcome", "scale", "share"), [(Outcome.SCALED, 0.25, 0.25), (Outcome.HELD, 0.0, 0.0)]
)
def test_the_gates_reduction_applies_after_the_modes(outcome: Outcome, scale: float, share: float) -> None:
    reflection = Reflection(CYCLE_S)
    reflection.take_verdict(verdict(outcome, scale))
    for _ in range(200):
        reflection.take(1.0, True, False)
    assert reflection.share == pytest.approx(share, abs=1e-3)
    reflection.take_verdict(verdict(Outcome.ADMITTED, 1.0))
    for _ in range(200):
        reflection.take(0.5, True, False)
    assert reflection.share == pytest.approx(1.0, abs=1e-3)


def test_the_executed_share_counts_only_the_requested_direction() -> None:
    run = PlainDrive("gr", DrivingMode.JOINT)
    hands = Hands(run.robot)
    asked = Motion.rest(9, 1)
    asked.joints[0] = 0.2
    rates = np.zeros(9)
    rates[:2] = 0.05, 9.0
    assert share_of(asked, rates, hands) == pytest.approx(0.25)
    assert share_of(asked, -rates, hands) == 0.0
    assert share_of(Motion.rest(9, 1), rates, hands) == 1.0
    hand = Motion.rest(9, 1)
    hand.hands[0, 2] = 0.1
    rates = np.linalg.pinv(hands.jacobian) @ np.array([0.5, 0.0, 0.04, 0.0, 0.0, 0.0])
    assert share_of(hand, rates, hands) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("share", "shown"), [(1.0, "[##########]"), (0.42, "[####......]"), (0.0, "[..........]")]
)
def test_a_bar_shows_the_share(share: float, shown: str) -> None:
    assert bar(share) == shown


MAX_DDQ = np.array([0.001, 0.002])


def view(cycle: int, q_cmd: np.ndarray) -> RobotView:
    return RobotView(cycle, 0.012 * cycle, q_cmd, q_cmd)


def test_the_last_increment_is_the_difference_of_consecutive_setpoints() -> None:
    last = LastIncrement(MAX_DDQ)
    np.testing.assert_array_equal(last.update(view(7, np.array([1.0, 2.0]))), [0.0, 0.0])
    np.testing.assert_allclose(last.update(view(8, np.array([1.1, 1.9]))), [0.1, -0.1])
    np.testing.assert_allclose(last.update(view(8, np.array([1.1, 1.9]))), [0.1, -0.1])


@pytest.mark.parametrize("missed", [1, 2, 5, 30])
@pytest.mark.parametrize("dq", [[0.01, -0.004], [0.0005, 0.0], [0.0, 0.0]])
def test_missed_cycles_count_as_braked(missed: int, dq: list[float]) -> None:
    last = LastIncrement(MAX_DDQ)
    q, admitted = np.array([1.0, 2.0]), np.array(dq)
    last.update(view(0, q))
    cycles = brake_cycles(admitted, MAX_DDQ)
    increments = [brake_increment(admitted, cycles, step) for step in range(missed + 1)]
    found = last.update(view(missed + 1, q + np.sum(increments, axis=0)))
    np.testing.assert_allclose(found, increments[-1], atol=1e-12)


def test_a_restarted_server_starts_from_rest() -> None:
    last = LastIncrement(MAX_DDQ)
    last.update(view(100, np.zeros(2)))
    np.testing.assert_array_equal(last.update(view(1, np.ones(2))), [0.0, 0.0])


def test_a_lost_increment_in_flight_does_not_change_the_last_increment() -> None:
    last, dq = LastIncrement(MAX_DDQ), np.array([0.01, 0.02])
    last.update(view(4, np.array([1.0, 2.0])))
    reckoned = view(5, np.array([1.0, 2.0]) + dq)
    np.testing.assert_allclose(last.update(reckoned), dq)
    for cycle in (5, 4):
        np.testing.assert_allclose(last.update(view(cycle, np.array([1.0, 2.0]))), dq)


def test_an_increment_in_flight_counts_as_commanded() -> None:
    last = LastIncrement(MAX_DDQ)
    seen = view(4, np.array([1.0, 2.0]))
    last.update(seen)
    dq = np.array([0.01, 0.02])
    ahead = seen.after(4, dq)
    np.testing.assert_allclose(ahead.q_cmd, [1.01, 2.02])
    np.testing.assert_allclose(last.update(ahead), dq)
    np.testing.assert_array_equal(ahead.q, seen.q)


# What is compiled of the hands' kinematics says what pinocchio says.


ROUNDING = 1e-12


def robot_named(name: str) -> RobotModel:
    return seven_axes.cell().robots["fr"] if name == "seven" else model(name)


@pytest.mark.parametrize("name", ["fr", "gr", "dawm", "seven"])
def test_poses_and_jacobians_of_all_hands_agree_with_pinocchio(name: str) -> None:
    robot = robot_named(name)
    hands, data = Hands(robot), robot.model.createData()
    random = np.random.default_rng(0)
    for _ in range(20):
        q = random.uniform(robot.lower, robot.upper)
        hands.update(q)
        pin.computeJointJacobians(robot.model, data, q)
        expected = []
        for hand, rotation, position in zip(robot.hands, hands.rotations, hands.positions, strict=True):
            frame = robot.frame_of(hand)
            placed = pin.updateFramePlacement(robot.model, data, frame)
            np.testing.assert_allclose(rotation, placed.rotation, atol=ROUNDING)
            np.testing.assert_allclose(position, placed.translation, atol=ROUNDING)
            expected.append(
                pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            )
        np.testing.assert_allclose(hands.jacobian, np.vstack(expected), atol=ROUNDING)


def test_placing_does_not_change_the_jacobian() -> None:
    robot = model("gr")
    hands = Hands(robot)
    hands.update(robot.home)
    before = hands.jacobian
    hands.place(robot.home + 0.1)
    np.testing.assert_array_equal(hands.jacobian, before)
    np.testing.assert_allclose(hands.positions[0], robot.forward(robot.home + 0.1)[:3, 3], atol=ROUNDING)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 0.3, 2.0, np.pi - 1e-5])
def test_rotation_and_rotation_vector_agree_with_pinocchio(angle: float) -> None:
    random = np.random.default_rng(1)
    axes = np.array([pin.exp3(random.normal(size=3)) for _ in range(2)])
    ways = random.normal(size=(2, 3))
    ways *= angle / np.linalg.norm(ways, axis=1)[:, None]
    there = turned(axes, ways)
    for one, way, other in zip(axes, ways, there, strict=True):
        np.testing.assert_allclose(other, pin.exp3(way) @ one, atol=ROUNDING)
    positions = random.normal(size=(2, 2, 3))
    found = displacement(axes, positions[0], there, positions[1])
    np.testing.assert_allclose(found[:, :3], positions[1] - positions[0], atol=ROUNDING)
    np.testing.assert_allclose(found[:, 3:], ways, atol=1e-9)


def test_a_rotation_by_half_a_turn_is_exact() -> None:
    axes = np.eye(3)[None]
    around = np.diag([-1.0, -1.0, 1.0])[None]
    found = displacement(axes, np.zeros((1, 3)), around, np.zeros((1, 3)))
    assert np.linalg.norm(found[0, 3:]) == pytest.approx(np.pi)


@pytest.mark.long
def test_an_edge_can_be_left_by_the_hand_as_well() -> None:
    run = PlainDrive("gr", DECOUPLED)
    run.drive(7.0, z=-0.2)
    low = run.robot.forward(run.now)[2, 3]
    run.drive(3.0, z=0.1)
    assert run.robot.forward(run.now)[2, 3] > low + 0.1
