"""The admission rate that a demonstration tells, between two statuses of a robot."""

from __future__ import annotations

import pytest

from deltaq_deploy.command.demo import admission_rate
from deltaq_protocol.messages import LeaseStatus, Phase, RobotStatus


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
def test_there_is_no_rate_without_cycles_of_one_process(before: RobotStatus, after: RobotStatus) -> None:
    assert admission_rate(before, after) is None


def test_only_what_came_in_between_counts() -> None:
    assert admission_rate(status(100, admissions=50), status(200, admissions=147)) == pytest.approx(0.97)
    assert admission_rate(status(100), status(200, admissions=100)) == 1.0
    assert admission_rate(status(100), status(200, braked_cycles=100)) == 0.0
