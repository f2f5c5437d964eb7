"""Adversaries on both robots, over wires that lose, delay, double and reorder: no invariant gives way."""

import pytest

from deltaq_testing.attack import run

pytestmark = pytest.mark.long


def assert_nothing_gave_way(report):
    assert report.violations == ()
    assert report.limits.total == 0
    assert report.gate.admitted > 0
    assert report.gate.scaled > 0
    assert report.gate.held > 0
    assert report.gate.refused > 0


def test_hundreds_of_decisions_under_attack_break_nothing():
    report = run(seed=4, duration_s=6.0)
    assert_nothing_gave_way(report)
    assert report.decided > 500


@pytest.mark.by_day(1)
@pytest.mark.parametrize("lookahead_cycles", [2, 3])
def test_admissions_in_flight_under_attack_break_no_invariant(tmp_path, lookahead_cycles):
    file = tmp_path / "ahead.yaml"
    file.write_text(
        f"extends: lab.yaml\ncell: ahead\ngate: {{lookahead_cycles: {lookahead_cycles}}}\n", encoding="utf-8"
    )
    report = run(file, seed=lookahead_cycles, duration_s=6.0)
    assert_nothing_gave_way(report)
    assert report.decided > 500


def test_one_seed_is_one_run():
    assert run(seed=3, duration_s=1.2) == run(seed=3, duration_s=1.2)


@pytest.mark.nightly
@pytest.mark.timeout(0)
@pytest.mark.parametrize("seed", range(1000, 1250))
def test_a_million_decisions_under_attack_break_nothing(seed):
    assert_nothing_gave_way(run(seed=seed, duration_s=30.0))
