"""Plants of many robots: what is measured is a cell that `deltaq check` accepts, and all robots of it move."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from deltaq_cell.check import check_cell
from deltaq_deploy.launch.program import run_program
from studies.scale import NEAREST_M, ScaleRow, main, measure, plant


def written(folder: Path, robots: int, bodies: int) -> Path:
    file = folder / "plant.yaml"
    file.write_text(yaml.safe_dump(plant(robots, bodies)), encoding="utf-8")
    return file


@pytest.mark.parametrize(("robots", "bodies"), [(1, 25), (3, 60)])
def test_a_plant_is_a_cell_without_an_error(tmp_path: Path, robots: int, bodies: int) -> None:
    report = check_cell(written(tmp_path, robots, bodies))
    assert report.errors == ()


def test_plants_of_a_seed_are_alike_and_keep_bodies_away_from_bases() -> None:
    assert plant(2, 40) == plant(2, 40) != plant(2, 40, seed=1)
    bodies = [body for name, body in plant(1, 40)["structure"].items() if name != "floor"]
    assert len(bodies) == 39
    for body in bodies:
        x, y, _ = body["pose"]["position_m"]
        assert x * x + y * y >= NEAREST_M**2


@pytest.mark.long
def test_pairs_grow_with_robots_and_bodies_and_every_robot_is_decided_on(tmp_path: Path) -> None:
    row = measure(written(tmp_path, 2, 25), cycles=5)
    assert isinstance(row, ScaleRow)
    assert (row.robots, row.bodies) == (2, 25)
    assert row.admitted == 1.0
    assert row.cycle_ms == pytest.approx(2.0 * row.decision_ms)
    assert measure(written(tmp_path, 2, 30), cycles=5).pairs > row.pairs > 500


@pytest.mark.long
@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["--robots", "2", "0"], "--robots [2, 0]: at least 1"),
        (["--bodies", "0"], "--bodies [0]: at least 1"),
        (["--cycles", "0"], "--cycles 0: at least 1"),
        (["--figure", "/nowhere/scale.png"], "/nowhere/scale.png"),
    ],
)
def test_a_failed_measurement_or_write_is_reported(
    wrong: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run_program(
            lambda: main(["--robots", "1", "--bodies", "5", "--cycles", "2", *wrong]),
            "studies.scale",
        )
    assert ended.value.code == 2
    assert told in capsys.readouterr().err
