from __future__ import annotations

import numpy as np
import pytest
from driving import PlainDrive, StackDrive, model

from deltaq_controllers.modes.interface import Limit, from_verdict
from deltaq_controllers.modes.motion import ModeName
from deltaq_protocol.messages import Outcome, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode

JOINT, DECOUPLED, SELF_MOTION, _, COUPLED = ModeName


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


def test_a_singularity_of_the_wrist_is_named_in_the_direction_that_is_lost_alone() -> None:
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
def test_an_edge_can_be_left_by_the_hand_as_well() -> None:
    run = PlainDrive("gr", DECOUPLED)
    run.drive(7.0, z=-0.2)
    low = run.robot.forward(run.now)[2, 3]
    run.drive(3.0, z=0.1)
    assert run.robot.forward(run.now)[2, 3] > low + 0.1


@pytest.mark.long
@pytest.mark.nightly
def test_what_the_gate_holds_is_named_and_joint_mode_leads_out() -> None:
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
