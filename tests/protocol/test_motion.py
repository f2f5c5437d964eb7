import numpy as np
import pinocchio as pin
import pytest

from deltaq.aio import rests_at
from deltaq.motion import REACHED, Motion, MotionError, joint_path
from deltaq.tool import Tool
from deltaq_cell.cell_model import CellModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_increment
from deltaq_protocol.messages import Outcome, Phase, Reason, RobotState, Verdict
from deltaq_protocol.reasons import ReasonCode

LAB = CellModel.load("lab")
TOLD = LAB.description_message()
CYCLE_S = TOLD.cycle_s
ROUNDING = 1e-9


def setpoints(
    motion: Motion, start: Array, robot: str, lost: float = 0.0, seed: int = 0, twice: float = 0.0
) -> Array:
    """The setpoints of a motion of which a share of increments is lost: then the robot brakes, as it really does.

    A share of increments is sent twice, as one is that is asked for again before its setpoint is known.
    """
    random = np.random.default_rng(seed)
    max_dv = np.array(TOLD.robots[robot].max_acceleration) * CYCLE_S**2
    rows, dq, braked = [start], np.zeros_like(start), 0
    for cycle in range(5000):
        asked = motion.increment(cycle, rows[-1])
        if asked is None:
            return np.array(rows)
        if random.random() < lost:
            braked += 1
            rows.append(rows[-1] + brake_increment(dq, brake_cycles(dq, max_dv), braked))
        else:
            # the gate lets through what lies within the limits of acceleration about the last increment
            before = brake_increment(dq, brake_cycles(dq, max_dv), braked)
            dq, braked = before + np.clip(asked - before, -max_dv, max_dv), 0
            rows.append(rows[-1] + dq)
            if random.random() < twice:
                rows.append(rows[-1] + dq)
    pytest.fail("it never arrived")


@pytest.mark.parametrize("robot", ["fr", "gr"])
@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_a_joint_motion_keeps_all_limits_and_ends_at_rest_at_its_target(robot: str, speed: float) -> None:
    summary = TOLD.robots[robot]
    start = np.array(summary.home)
    target = start + 0.3 * np.array([1, -1, 1, 0, 1, -1, 1, 1, -1])[-len(start) :]
    rows = setpoints(Motion(robot, np.stack([start, target]), summary, CYCLE_S, speed), start, robot)
    steps = np.diff(rows, axis=0, prepend=rows[:1], append=rows[-1:])
    assert np.abs(rows[-1] - target).max() < ROUNDING
    assert (np.abs(steps) <= speed * np.array(summary.max_increment) + ROUNDING).all()
    changes = np.abs(np.diff(steps, axis=0))
    assert (changes <= np.array(summary.max_acceleration) * CYCLE_S**2 + ROUNDING).all()
    along = (rows - start) @ (target - start) / float((target - start) @ (target - start))
    assert np.abs(start + along[:, None] * (target - start) - rows).max() < ROUNDING


@pytest.mark.parametrize("off", [0.0, 1e-12, 1e-6])
def test_a_motion_to_the_present_configuration_ends(off: float) -> None:
    summary = TOLD.robots["fr"]
    start = np.array(summary.home)
    rows = setpoints(Motion("fr", np.stack([start, start + off]), summary, CYCLE_S), start, "fr")
    assert len(rows) < 10


@pytest.mark.parametrize("seed", range(5))
def test_a_motion_arrives_despite_losing_every_tenth_increment(seed: int) -> None:
    summary = TOLD.robots["fr"]
    start = np.array(summary.home)
    target = start + np.array([0.5, -0.1, 0.1, 0.4, -0.2, 1.0])
    rows = setpoints(Motion("fr", np.stack([start, target]), summary, CYCLE_S, 0.8), start, "fr", 0.1, seed)
    assert np.abs(rows[-1] - target).max() < ROUNDING
    assert (np.diff(rows, axis=0) * np.sign(target - start) > -ROUNDING).all()  # it never goes back


@pytest.mark.parametrize("seed", range(10))
def test_a_motion_with_repeated_increments_returns_to_its_target(seed: int) -> None:
    summary = TOLD.robots["fr"]
    start = np.array(summary.home)
    target = start + np.array([0.5, -0.1, 0.1, 0.4, -0.2, 1.0])
    motion = Motion("fr", np.stack([start, target]), summary, CYCLE_S, 0.8)
    rows = setpoints(motion, start, "fr", 0.1, seed, twice=0.2)
    assert np.abs(rows[-1] - target).max() < REACHED


def test_a_motion_ends_only_after_the_drives_arrived() -> None:
    summary = TOLD.robots["fr"]
    start = np.array(summary.home)
    motion = Motion("fr", np.stack([start, start + 1e-3]), summary, CYCLE_S)
    assert [motion.increment(cycle, start + 1e-3) for cycle in range(round(5 / CYCLE_S))] == [None] * 417


@pytest.mark.parametrize("off", [1e-2, -1e-2, np.array([0, 1e-2, 0, 0, 0, -1e-3])])
def test_a_robot_beyond_or_beside_its_target_returns_to_it(off: float | Array) -> None:
    summary = TOLD.robots["fr"]
    start = np.array(summary.home)
    motion = Motion("fr", np.stack([start, start + 0.1]), summary, CYCLE_S)
    motion.increment(0, start + 0.1)
    rows = setpoints(motion, start + 0.1 + off, "fr")
    assert np.abs(rows[-1] - start - 0.1).max() < REACHED


def test_a_motion_blocked_by_the_gate_names_the_reason() -> None:
    summary = TOLD.robots["fr"]
    start = np.array(summary.home)
    motion = Motion("fr", np.stack([start, start + 0.1]), summary, CYCLE_S)
    reason = Reason(code=ReasonCode.CLEARANCE, what="fr/hand gr/hand", value=0.0499, bound=0.05)
    motion.take(Verdict(robot="fr", cycle=1, seq=1, outcome=Outcome.HELD, reasons=(reason,)))
    for cycle in range(round(0.5 / CYCLE_S) + 1):
        motion.increment(cycle, start)
    with pytest.raises(
        MotionError, match=r"^clearance: fr stopped with 100% .* fr/hand gr/hand 0\.0499 m \(bound 0\.05 m\)"
    ) as e:
        motion.increment(round(0.5 / CYCLE_S) + 1, start)
    assert (e.value.code, e.value.value, e.value.bound) == ("clearance", 0.0499, 0.05)


def test_a_forbidden_increment_ends_a_motion_and_a_late_one_does_not() -> None:
    motion = Motion("fr", np.stack([np.zeros(6), np.ones(6)]), TOLD.robots["fr"], CYCLE_S)
    refused = Verdict(robot="fr", cycle=1, seq=1, outcome=Outcome.REFUSED)
    motion.take(refused.model_copy(update={"reasons": (Reason(code=ReasonCode.STALE_CYCLE),)}))
    with pytest.raises(MotionError, match="not_permitted"):
        motion.take(refused.model_copy(update={"reasons": (Reason(code=ReasonCode.NOT_PERMITTED),)}))


@pytest.mark.parametrize(
    ("target", "told"),
    [
        ([0.0] * 5, r"fr has 6 joints, the target has the shape \(5,\)"),
        ([9.0, 0, 0, 0, 0, 0], r"target of joint .*: 9 rad is not from -3\.\d+ to"),
        ([float("nan"), 0, 0, 0, 0, 0], "nan rad is not from"),
    ],
)
def test_an_impossible_target_is_refused_with_its_bounds(target: list[float], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        joint_path("fr", TOLD.robots["fr"], np.zeros(6), np.array(target))


@pytest.mark.parametrize("speed", [0.0, -1.0, 1.01, float("nan")])
def test_a_speed_out_of_its_range_is_refused(speed: float) -> None:
    with pytest.raises(ValueError, match=r"speed: .* is not above 0 and at most 1"):
        Motion("fr", np.zeros((2, 6)), TOLD.robots["fr"], CYCLE_S, speed)


@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_pose_and_jacobian_of_the_tool_agree_with_the_robot_model(robot: str) -> None:
    tool, model = Tool(TOLD.kinematics[robot], TOLD.robots[robot]), LAB.robots[robot]
    random = np.random.default_rng(3)
    for _ in range(20):
        q = random.uniform(model.lower, model.upper)
        told = model.tool_pose(q)
        w, x, y, z = told.quaternion_wxyz
        assert np.abs(tool.pose(q)[:3, 3] - told.position).max() < 1e-12
        assert np.abs(tool.pose(q)[:3, :3] - pin.Quaternion(w, x, y, z).matrix()).max() < 1e-12
        rates = random.normal(size=len(q))
        after, before = tool.pose(q + 1e-6 * rates), tool.pose(q - 1e-6 * rates)
        velocity = (after[:3, 3] - before[:3, 3]) / 2e-6
        assert np.abs(tool.jacobian(q)[:3] @ rates - velocity).max() < 1e-6


@pytest.mark.parametrize("robot", ["fr", "gr"])
def test_a_tool_line_is_straight_without_rotation_and_keeps_all_limits(robot: str) -> None:
    summary, way = TOLD.robots[robot], np.array([0.03, -0.02, -0.05])
    tool, start = Tool(TOLD.kinematics[robot], summary), np.array(summary.home)
    path = tool.line(robot, start, way)
    rows = setpoints(Motion(robot, path, summary, CYCLE_S, 0.5), start, robot)
    began = tool.pose(start)
    for q in rows:
        pose = tool.pose(q)
        off = pose[:3, 3] - began[:3, 3]
        assert np.linalg.norm(off - way * float(off @ way) / float(way @ way)) < 1e-4
        assert np.abs(pose[:3, :3] - began[:3, :3]).max() < 1e-3
    assert np.abs(tool.pose(rows[-1])[:3, 3] - began[:3, 3] - way).max() < 1e-6
    steps = np.diff(rows, axis=0, prepend=rows[:1], append=rows[-1:])
    changes = np.abs(np.diff(steps, axis=0))
    assert (changes <= np.array(summary.max_acceleration) * CYCLE_S**2 + ROUNDING).all()


def test_an_unreachable_line_reports_its_reachable_length() -> None:
    summary = TOLD.robots["fr"]
    tool = Tool(TOLD.kinematics["fr"], summary)
    with pytest.raises(ValueError, match=r"the tool of fr can move \d\.\d+ m of 5\.000 m: "):
        tool.line("fr", np.array(summary.home), np.array([0.0, 0.0, 5.0]))


@pytest.mark.parametrize(
    ("setpoint", "measured", "before", "rests"),
    [
        (0.0, 1e-3, 1e-3, True),
        (0.0, 1e-3, 2e-3, False),  # it moves
        (0.0, 3e-3, 3e-3, False),  # the drives have not followed yet
        (1.5e-3, 1.5e-3, 1.5e-3, False),  # the last increments are on their way
    ],
)
def test_a_robot_rests_when_setpoint_and_drives_reached_the_target(
    setpoint: float, measured: float, before: float, rests: bool
) -> None:
    def state(q: float) -> RobotState:
        joints = {"q": (q,) * 6, "q_cmd": (setpoint,) * 6}
        return RobotState.model_construct(robot="fr", cycle=1, phase=Phase.ENGAGED, **joints)

    assert rests_at(np.zeros(6), state(before), state(measured)) is rests
