"""How often the advisor's advice can be driven, measured and driven."""

from __future__ import annotations

import json

import pytest

from deltaq_experiments import advised_drive
from deltaq_experiments.advised_starts import AdvisedStarts, main, run

pytestmark = pytest.mark.long


def test_what_was_made_of_the_starts_is_told_as_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--robot", "dawm", "--starts", "2", "--seed", "5", "--json"])
    found = AdvisedStarts.model_validate(json.loads(capsys.readouterr().out))
    assert (found.robot, found.starts, found.seed, found.driven) == ("dawm", 2, 5, 0)
    assert found.improving <= found.drivable <= 1.0
    assert found.p50_s <= found.p99_s <= found.longest_s
    assert sum(found.tightest.values()) <= sum(found.bound_by.values())


@pytest.mark.parametrize("robot", ["dawm", pytest.param("gr", marks=pytest.mark.nightly)])
def test_the_best_option_of_a_start_is_reached_through_the_gate_with_the_hands_in_place(robot: str) -> None:
    found = run(robot, 2, seed=6, drive=1)
    assert (found.driven, found.reached) == (1, 1)
    assert found.hands_off_m is not None
    assert found.hands_off_m < (1e-4 if robot == "dawm" else 1e-3)


def test_a_drive_that_is_not_over_is_not_told_as_one_that_arrived(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advised_drive, "LONGEST_S", 0.1)
    found = run("dawm", 2, seed=6, drive=1)
    assert (found.driven, found.reached) == (1, 0)
