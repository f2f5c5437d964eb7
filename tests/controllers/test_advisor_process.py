"""The advisor's own process: asked, given up, asked again, and gone."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable

import numpy as np
import pytest

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.process import AdvisorProcess
from deltaq_controllers.modes.advisor import tracker_of

pytestmark = pytest.mark.service

LAB = CellModel.load("lab")
GR = LAB.robots["gr"]
OTHERS = {"fr": LAB.robots["fr"].home}


def advisor(**weights: float) -> AdvisorProcess:
    return AdvisorProcess(
        CellModel.load("lab").description_message(), tracker_of(GR), lambda: OTHERS, weights or None
    )


def wait_for(advisor: AdvisorProcess, reached: Callable[[], bool]) -> None:
    """Until what the process has said makes it so; each wait ends with a word of it."""
    deadline = time.monotonic() + 60
    while not reached():
        assert advisor._line.poll(max(0.0, deadline - time.monotonic())), "the process says nothing"


def test_options_come_first_their_ways_follow_and_a_question_given_up_is_answered_no_more() -> None:
    with advisor() as asked:
        asked.ask(GR.home)
        assert asked.is_busy
        wait_for(asked, lambda: asked.progress is not None and bool(asked.progress.options))
        assert asked.is_busy
        asked.give_up()
        assert not asked.is_busy
        assert asked.progress is not None
        first = asked.progress.options
        elsewhere = GR.home + np.eye(GR.n)[0] * 0.1
        asked.ask(elsewhere)
        wait_for(asked, lambda: not asked.is_busy)
        assert asked.trouble == ""
        options = asked.progress.options
        assert len(options) == len(first)
        for option in options:
            np.testing.assert_array_equal(option.start, elsewhere)
            assert option.path is not None or option.no_path
        asked.seek(elsewhere[None], 1)
        assert asked.is_busy
        wait_for(asked, lambda: not asked.is_busy)
        assert asked.progress.options[0].path is not None


def test_what_cannot_be_answered_is_told() -> None:
    with advisor(travle=1.0) as asked:
        asked.ask(GR.home)
        wait_for(asked, lambda: not asked.is_busy)
        assert asked.trouble.startswith("no criterion 'travle'; there are travel")


def test_a_process_that_has_ended_is_told_and_ends_no_loop() -> None:
    with advisor() as asked:
        asked.ask(GR.home)
        assert asked._process.pid is not None
        os.kill(asked._process.pid, signal.SIGKILL)
        wait_for(asked, lambda: not asked.is_busy)
        assert "the advisor's process has ended" in asked.trouble
        asked.ask(GR.home)
        assert "the advisor's process has ended" in asked.trouble
