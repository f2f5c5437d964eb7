"""How often the advisor's advice can be driven, measured and driven."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import published_arms
import pytest

from deltaq_deploy.launch.program import run_program
from studies import advised_drive
from studies.advised_starts import AdvisedStarts, main, run

pytestmark = pytest.mark.long


def test_the_result_of_the_starts_is_one_object(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--robot", "dawm", "--starts", "2", "--seed", "5", "--json"])
    found = AdvisedStarts.model_validate(json.loads(capsys.readouterr().out))
    assert (found.robot, found.starts, found.seed, found.driven) == ("dawm", 2, 5, 0)
    assert found.improving <= found.drivable <= 1.0
    assert found.p50_s <= found.p99_s <= found.longest_s
    assert sum(found.tightest.values()) <= sum(found.bound_by.values())


@pytest.mark.nightly
def test_a_robot_of_ones_own_is_asked_about_in_its_cell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "arms.yaml").write_text(published_arms.description(), encoding="utf-8")
    cell = str(tmp_path / "arms.yaml")
    main(["--cell", cell, "--robot", "panda", "--starts", "2", "--json"])
    found = AdvisedStarts.model_validate(json.loads(capsys.readouterr().out))
    assert (found.robot, found.starts) == ("panda", 2)
    assert found.drivable == 1.0
    for wrong, said in (
        (["--robot", "panda"], "name its cell as well"),
        (["--cell", cell, "--robot", "pandar"], "no robot 'pandar'; it has"),
        (["--cell", cell, "--robot", "ur"], "'ur' is not redundant"),
    ):
        with pytest.raises(SystemExit):
            run_program(partial(main, wrong), "studies.advised_starts")
        assert said in capsys.readouterr().err


@pytest.mark.nightly
@pytest.mark.parametrize("robot", ["dawm", "gr"])
def test_the_best_option_of_a_start_is_reached_through_the_gate_with_the_hands_in_place(robot: str) -> None:
    found = run(robot, 2, seed=6, drive=1)
    assert (found.driven, found.reached) == (1, 1)
    assert found.hands_off_m is not None
    assert found.hands_off_m < (1e-4 if robot == "dawm" else 1e-3)


@pytest.mark.nightly
def test_a_drive_that_is_not_over_is_not_told_as_one_that_arrived(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(advised_drive, "LONGEST_S", 0.1)
    found = run("dawm", 2, seed=6, drive=1)
    assert (found.driven, found.reached) == (1, 0)
