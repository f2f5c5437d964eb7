"""Counts of a controller's run: verdicts, reasons, and errors after the start-up."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

from deltaq_protocol.messages import Outcome, Verdict


class ErrorStatistics:
    """Root mean square, largest and last size of an error."""

    def __init__(self) -> None:
        self._count = 0
        self._squares = 0.0
        self._max = 0.0
        self._final = 0.0

    def add(self, error: float, settled: bool) -> None:
        """Add an error; before the start-up is over it only counts as the last one."""
        self._final = abs(error)
        if settled:
            self._count += 1
            self._squares += error * error
            self._max = max(self._max, abs(error))

    def figures(self, unit: float = 1.0) -> dict[str, float | None]:
        """`rms` and `max`, None while there is nothing after the start-up, and `final`; in parts of `unit`."""
        if not self._count:
            return {"rms": None, "max": None, "final": self._final / unit}
        rms = math.sqrt(self._squares / self._count)
        return {"rms": rms / unit, "max": self._max / unit, "final": self._final / unit}


class ControlStatistics:
    """Cycles, verdicts by outcome, and reasons by code.

    Attributes:
        cycles: increments requested.
        unanswered: increments without a verdict.
    """

    def __init__(self) -> None:
        self.cycles = 0
        self.unanswered = 0
        self._outcomes: Counter[str] = Counter(
            {outcome.value: 0 for outcome in Outcome if outcome is not Outcome.UNKNOWN}
        )
        self._reasons: Counter[str] = Counter()

    def add(self, verdict: Verdict | None) -> None:
        """Count the verdict on an increment; None, or one of outcome `unknown`, if it never came."""
        self.cycles += 1
        if verdict is None or verdict.outcome is Outcome.UNKNOWN:
            self.unanswered += 1
            return
        self._outcomes[verdict.outcome.value] += 1
        self._reasons.update(reason.code.value for reason in verdict.reasons)

    def summary(self) -> dict[str, Any]:
        """The counts as a JSON object."""
        return {
            "cycles": self.cycles,
            "unanswered": self.unanswered,
            "gate": dict(self._outcomes),
            "reasons": dict(self._reasons),
        }
