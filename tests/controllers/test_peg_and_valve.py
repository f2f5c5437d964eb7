from __future__ import annotations

import pytest

from deltaq_controllers.interface import ControllerError
from deltaq_experiments.peg_and_valve import ModeFigures, run


def done_well(figures: ModeFigures) -> bool:
    return figures.peg_off_mm < 1.5 and figures.peg_tilt_deg < 0.5 and figures.valve_off_mm < 1.5


@pytest.mark.long
def test_coupled_mode_puts_the_peg_in_straight_and_turns_the_valve_in_place() -> None:
    (figures,) = run(modes=["coupled"])
    assert done_well(figures)
    assert figures.time_s < 25.0
    assert figures.gate["held"] == figures.gate["refused"] == 0


def test_an_unknown_mode_or_robot_is_named() -> None:
    with pytest.raises(ControllerError, match="no mode 'fly' for this task; there are joint, decoupled"):
        run(modes=["fly"])
    with pytest.raises(ControllerError, match="no robot 'xx'; it has fr, gr"):
        run(robot="xx", modes=["coupled"])
    with pytest.raises(ControllerError, match="one hand, robot 'dawm' has left, right"):
        run("dawm", "dawm", modes=["coupled"])


@pytest.mark.nightly
@pytest.mark.timeout(600)
def test_the_modes_compare_as_the_paper_concludes() -> None:
    joint, decoupled, self_motion, advisor, coupled = run()
    assert done_well(decoupled)
    assert done_well(self_motion)
    assert done_well(advisor)
    assert done_well(coupled)
    # joint mode is not suited to precise control of the hand
    assert joint.time_s > 5 * coupled.time_s
    assert joint.peg_off_mm > 5.0
    # self-motion betters the posture and costs time
    assert self_motion.limit_margin > decoupled.limit_margin
    assert self_motion.time_s > decoupled.time_s
    # so does the advisor
    assert advisor.limit_margin > decoupled.limit_margin
    assert advisor.time_s > decoupled.time_s
    # coupled does that on the way
    assert coupled.limit_margin > decoupled.limit_margin
    assert coupled.time_s < 1.1 * decoupled.time_s
