"""Several cells side by side: what is made of their benchmarks, and one that really runs."""

from __future__ import annotations

import json

import pytest

from deltaq_experiments.bench.live import LiveRun
from deltaq_experiments.bench.live_figures import RobotFigures, StationAges
from deltaq_experiments.bench.quantiles import Quantiles
from deltaq_experiments.many_cells import main, measure, summary
from deltaq_launch.program import run_program


def robot(rate: float | None, decided_ms: list[float]) -> RobotFigures:
    decided = StationAges(
        station="decided",
        age_ms=Quantiles.of(decided_ms),
        missing=0,
        hops=4,
        reference_ms=None,
        ratio_p50=None,
        ratio_p99=None,
    )
    return RobotFigures(
        cycles=100,
        fresh=0,
        admission_rate=rate,
        braked={},
        increments=len(decided_ms),
        stations=(decided,),
        longest_client_cycle_ms=None,
    )


def run(in_time: float, processor_us: float, **robots: RobotFigures) -> LiveRun:
    return LiveRun(
        robots=robots,
        processor_us={"sim": processor_us / 2, "hli": processor_us / 2},
        reference={"language": "C", "in_time": in_time},
        rows=(),
        silent=(),
        overwritten=0,
    )


def test_the_worst_robot_and_the_slowest_decision_of_all_cells_are_told() -> None:
    one = run(0.99, 6000.0, fr=robot(0.9, [3.0]), gr=robot(1.0, [4.0]))
    other = run(0.97, 12000.0, fr=robot(0.5, [9.0]), gr=robot(None, []))
    row = summary(3, [one, other], cycle_s=0.012, cores=2)
    assert (row.cells, row.started) == (3, 2)
    assert row.admission_rate == pytest.approx((0.0, 0.6))
    assert row.decided_ms == 9.0
    assert row.processor_share == pytest.approx(0.75)
    assert row.reference_in_time == 0.97


def test_where_no_cell_came_up_nothing_is_made_up() -> None:
    row = summary(8, [], cycle_s=0.012, cores=2)
    assert (row.cells, row.started) == (8, 0)
    told = (row.admission_rate, row.decided_ms, row.processor_share, row.reference_in_time)
    assert told == (None, None, None, None)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["--cells", "0"], "--cells [0]: at least 1"),
        (["--duration-s", "0"], "--duration-s 0.0: at least 0.5"),
        (["--duration-s", "nan"], "--duration-s nan: at least 0.5"),
        (["--cell", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_measured_is_said(
    wrong: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run_program(lambda: main(["--cells", "1", *wrong]), "deltaq_experiments.many_cells")
    assert ended.value.code == 2
    assert told in capsys.readouterr().err


@pytest.mark.nightly
def test_a_cell_that_does_not_come_up_is_counted_and_waited_for_no_longer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")  # no program that a launcher starts is found there
    row = measure("lab", 1, duration_s=0.5)
    assert (row.started, row.admission_rate) == (0, None)


@pytest.mark.live
@pytest.mark.nightly
def test_a_cell_that_runs_alone_is_told_with_its_reference(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--cells", "1", "--duration-s", "2", "--json"])
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["cells"], row["started"]) == (1, 1)
    assert 0.0 < row["processor_share"] < 1.0
    assert row["admission_rate"][0] > 0.0
    assert row["reference_in_time"] > 0.0
