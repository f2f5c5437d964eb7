"""The doctor on real-time priority: what was asked, what was given, and the remedy."""

import os

import pytest

from deltaq_deploy.launch.doctor import ASKED, Rating, examine_real_time, judge_priority, judge_throttling


def test_a_refusal_names_policy_priority_limit_and_remedy() -> None:
    refused = judge_priority(given=False, limit=0)
    assert refused.verdict is Rating.FAIR
    assert (
        refused.found
        == f"asked for SCHED_FIFO {ASKED}: refused (RLIMIT_RTPRIO 0); services run as SCHED_OTHER"
    )
    assert f"rtprio {ASKED}" in refused.advice
    given = judge_priority(given=True, limit=-1)
    assert (given.verdict, given.advice) == (Rating.GOOD, "")
    assert given.found.endswith("given (RLIMIT_RTPRIO unlimited)")


@pytest.mark.parametrize(
    ("runtime_us", "period_us", "verdict", "found"),
    [
        (950_000, 1_000_000, Rating.GOOD, "95% at most"),
        (-1, 1_000_000, Rating.FAIR, "off"),
        (1_000_000, 1_000_000, Rating.FAIR, "off"),
        (None, None, Rating.FAIR, "does not say"),
    ],
)
def test_disabled_throttling_is_reported_with_the_remedy(
    runtime_us: int | None, period_us: int | None, verdict: Rating, found: str
) -> None:
    finding = judge_throttling(runtime_us, period_us)
    assert finding.verdict is verdict
    assert found in finding.found
    assert (finding.advice == "") is (verdict is Rating.GOOD)


def test_the_query_does_not_change_this_process() -> None:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    assert [finding.what for finding in examine_real_time()] == ["real-time priority", "real-time throttling"]
    assert (os.sched_getscheduler(0), os.sched_getparam(0)) == before
