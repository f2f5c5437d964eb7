"""How conservative the gate is: the auditor tells refusals that were needed from those that were not."""

from dataclasses import replace

import numpy as np
import pytest

from deltaq_protocol.messages import Outcome, Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.virtual_cell.cell import VirtualCell
from studies.conservatism import Auditor, ConservatismFigures, run


class Timid:
    """A gate that says of everything that it would come too near."""

    def __init__(self, gate):
        self._gate = gate

    def decide(self, robot, others, request):
        decision = self._gate.decide(robot, others, request)
        reason = Reason(code=ReasonCode.CLEARANCE, what="fr/link_1 structure/floor", value=0.0, bound=0.05)
        return replace(decision, outcome=Outcome.HELD, scale=0.0, reasons=(reason,))


def test_unnecessary_refusals_are_found_with_their_remaining_clearance():
    stack = VirtualCell("lab")
    stack.sim.gate = auditor = Auditor(Timid(stack.sim.gate), stack.cell, every=1, samples=5)
    stack.run_until_ready()
    stack.acquire("fr", "test")
    for _ in range(5):
        stack.cycle()
        stack.ask("fr", np.zeros(6))
    figures = ConservatismFigures(auditor.decisions, auditor.bound, tuple(auditor.rooms_m))
    assert (figures.bound_by_clearance, figures.confirmed) == (figures.decisions, 0)
    assert figures.decisions > 0
    assert figures.excess_mm["p50"] > 10.0


@pytest.mark.nightly
def test_most_refusals_of_adversaries_are_confirmed():
    figures = run("lab", seed=0, cycles=1500, every=5, samples=40)
    assert len(figures.rooms_m) > 10
    assert figures.confirmed_share > 0.8
    assert figures.excess_mm["most"] < 20.0


def test_figures_of_several_runs_are_summed():
    one = ConservatismFigures(10, 3, (-0.001, 0.002))
    both = one + ConservatismFigures(5, 2, (-0.003,))
    assert (both.decisions, both.bound_by_clearance, both.confirmed) == (15, 5, 2)
    assert both.confirmed_share == pytest.approx(2 / 3)
    assert both.excess_mm["most"] == pytest.approx(2.0)
    assert both.excess_mm["p50"] == 0.0
    assert ConservatismFigures(1, 0, ()).confirmed_share is None
    assert ConservatismFigures(1, 0, ()).told()["excess_mm"] == {}
