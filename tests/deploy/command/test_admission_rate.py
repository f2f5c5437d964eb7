"""What a demonstration tells: the admission rate between two statuses of a robot, and four lines in words."""

from typing import Any

import pytest

from deltaq_deploy.command.demo import NEXT, admission_rate, in_words
from deltaq_protocol.messages import LeaseStatus, Phase, RobotStatus, Sight


def status(cycle: int, **counters: int) -> RobotStatus:
    lease = LeaseStatus(holder=None, expires_s=None, epoch=0)
    return RobotStatus(
        phase=Phase.ENGAGED, reason=None, cycle=cycle, state_age_s=0.0, q=(), lease=lease, counters=counters
    )


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (status(0), status(0)),
        (status(100, admissions=50), status(100, admissions=50)),
        (status(100, admissions=50), status(20, admissions=10)),  # its Robot Server began anew
        (status(100, admissions=50), status(120, admissions=10)),  # and has overtaken itself
    ],
)
def test_the_rate_needs_cycles_of_one_process(before: RobotStatus, after: RobotStatus) -> None:
    assert admission_rate(before, after) is None


def test_the_rate_counts_only_cycles_between_two_readings() -> None:
    assert admission_rate(status(100, admissions=50), status(200, admissions=147)) == pytest.approx(0.97)
    assert admission_rate(status(100), status(200, admissions=100)) == 1.0
    assert admission_rate(status(100), status(200, braked_cycles=100)) == 0.0


def summary(angle_deg: float | None, **sights: int) -> dict[str, Any]:
    seen = {sight.value: 0 for sight in Sight} | sights
    figures = {"rms": angle_deg, "max": 0.5, "final": 0.1}
    return {
        "cycle_s": 0.012,
        "robots": {"fr": {"missed": 0, "cycles": {"count": 1600}, "admission_rate": 0.995}},
        "tracking": {"angle_deg": figures, "distance_m": {**figures, "rms": 0.004}, "view": seen},
        "gate": {"admitted": 3000, "scaled": 12, "held": 3},
    }


def test_the_demonstration_ends_with_four_lines_in_words() -> None:
    camera, gate, cycles, following = in_words(summary(0.2, fresh=900, view_hidden=100))
    assert camera == (
        "camera: it kept the target within 0.20° and 0.4 cm (rms; at most 0.50° and 50.0 cm), the paper within 1° and "
        "2 cm; it saw the target in 90% of the cycles"
    )
    assert (
        gate == "gate: it admitted 3000 increments in full, limited 12, replaced 3 by braking and refused 0"
    )
    assert cycles == (
        "cycles of 12 ms, as a client saw them: fr missed none of its 1600 cycles and moved as admitted in 99.5%"
    )
    assert following == NEXT


@pytest.mark.parametrize(
    ("tracking", "said"), [(None, "no figures"), (summary(None)["tracking"], "too short")]
)
def test_the_demonstration_reports_a_camera_that_cannot_be_judged(
    tracking: dict[str, Any] | None, said: str
) -> None:
    assert said in in_words(summary(0.2) | {"tracking": tracking})[0]
