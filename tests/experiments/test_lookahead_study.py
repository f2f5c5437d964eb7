"""What a lookahead costs and saves: with it late admissions are in time, and every one of them comes later."""

from __future__ import annotations

from pathlib import Path

import pytest

from deltaq_experiments.lookahead import ANSWER_TIMES, LookaheadRow, draw, main, rows
from deltaq_launch.program import run_program

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def found() -> dict[int, LookaheadRow]:
    slow_gate = ANSWER_TIMES[-1]
    measured = rows((1, 3), seeds=1, cycles=60, on_row=lambda _: None, kinds=(slow_gate,))
    return {row.lookahead_cycles: row for row in measured}


def test_a_lookahead_saves_cycles_of_the_brake_and_costs_latency(found: dict[int, LookaheadRow]) -> None:
    assert found[1].braked_share > 0.2  # else nothing was late
    assert found[3].braked_share < 0.1
    assert found[3].latency_ms > found[1].latency_ms + 8.0
    assert len(found[1].braked) == 1


def test_the_figure_has_the_kinds_of_delays_that_were_measured(
    found: dict[int, LookaheadRow], tmp_path: Path
) -> None:
    draw(list(found.values()), tmp_path / "lookahead.png")
    assert (tmp_path / "lookahead.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (["--lookaheads", "0"], "--lookaheads [0]: at least 1"),
        (["--lookaheads", "9"], "lookahead_cycles"),
        (["--seeds", "0"], "--seeds 0: at least 1"),
        (["--cycles", "0"], "--cycles 0: at least 1"),
    ],
)
def test_what_cannot_be_measured_is_said(
    wrong: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        run_program(
            lambda: main(["--lookaheads", "1", "--seeds", "1", "--cycles", "1", *wrong]),
            "deltaq_experiments.lookahead",
        )
    assert ended.value.code == 2
    assert told in capsys.readouterr().err
