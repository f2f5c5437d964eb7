"""Inverses side by side on the arms of a cell."""

from __future__ import annotations

import json

import pytest

from deltaq_experiments.inverse_bench import main
from deltaq_launch.exit_status import USAGE
from deltaq_launch.program import run_program


@pytest.mark.long
def test_every_arm_is_solved_by_all_roads_that_it_has(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--cell", "lab", "--poses", "20", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(row["robot"], row["inverse"]) for row in rows] == [
        (robot, inverse)
        for robot in ("fr", "gr")
        for inverse in ("own", "6R-SPHERICAL_SECOND_TWO_PARALLEL", "numeric")
    ]
    for row in rows:
        assert row["error"] < 1e-9
        assert row["batch_us"] > 0.0
        assert row["single_us"] > 0.0
        assert row["missed"] <= (0.1 if row["inverse"] == "numeric" else 0.0)


def test_a_user_s_mistake_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run_program(lambda: main(["--cell", "nowhere"]), "inverse_bench")
    assert ended.value.code == USAGE
    assert capsys.readouterr().err.startswith("inverse_bench: nowhere: no cell of that name")
    with pytest.raises(SystemExit):
        main(["--poses", "0"])
    assert "--poses 0: at least 1" in capsys.readouterr().err
