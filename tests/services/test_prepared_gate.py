"""What `python -m deltaq_cell` compiles is all that the gate needs: no decision waits for the compiler."""

from __future__ import annotations

import subprocess
import sys

import pytest

DECIDE = """
from deltaq_cell.__main__ import main
from deltaq_cell.compiled import told_of_compiling
main()
from deltaq_cell.cell_model import CellModel
from deltaq_experiments.bench.cornered import stored
from deltaq_protocol import topics
from deltaq_services.sim.core import Sim
outcomes = set()
with told_of_compiling(lambda name: print("compiled late:", name)):
    sim = Sim(CellModel.load("lab"), epoch=0)
    for situation in stored():
        sim.restore(situation.memory)
        for output in sim.take(situation.request):
            if output.topic is topics.GATE_VERDICT:
                outcomes.add(output.message.outcome.value)
print(*sorted(outcomes))
"""


@pytest.mark.long
def test_a_gate_that_was_prepared_compiles_nothing_for_its_decisions() -> None:
    decided = subprocess.run([sys.executable, "-c", DECIDE], capture_output=True, text=True, check=True)
    assert {"held", "scaled"} <= set(decided.stdout.splitlines()[-1].split())
    assert "compiled late" not in decided.stdout
