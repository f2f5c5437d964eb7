import json
import math

import pytest

from deltaq_controllers.statistics import ControlStatistics, ErrorStatistics
from deltaq_protocol.messages import Outcome, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode


def test_figures_count_from_the_end_of_the_start_up_and_are_sizes() -> None:
    errors = ErrorStatistics()
    errors.add(9.0, settled=False)
    assert errors.figures() == {"rms": None, "max": None, "final": 9.0}
    for error in (3.0, -4.0):
        errors.add(error, settled=True)
    assert errors.figures() == {"rms": pytest.approx(math.sqrt(12.5)), "max": 4.0, "final": 4.0}
    assert errors.figures(unit=2.0)["max"] == 2.0


def test_verdicts_and_reasons_are_counted_and_silence_too() -> None:
    statistics = ControlStatistics()
    bound = Reason(code=ReasonCode.CLEARANCE)
    statistics.add(Verdict(robot="fr", cycle=1, seq=1, outcome=Outcome.ADMITTED))
    statistics.add(Verdict(robot="fr", cycle=2, seq=2, outcome=Outcome.SCALED, reasons=(bound,)))
    statistics.add(None)
    statistics.add(Verdict(robot="fr", cycle=4, seq=4, outcome=Outcome.UNKNOWN))
    summary = statistics.summary()
    assert summary == {
        "cycles": 4,
        "unanswered": 2,
        "gate": {"admitted": 1, "scaled": 1, "held": 0, "refused": 0, "carried": 0},
        "reasons": {"clearance": 1},
    }
    json.dumps(summary)
