"""Admissions that have come before the cycle in which they are due."""

from __future__ import annotations

from deltaq_protocol import topics
from deltaq_protocol.guarded import Admission
from deltaq_services.robot_server.guards import Refusal


class AdmissionsDue:
    """Keeps admissions until their cycle, one for each of the next few; the newest counts.

    Args:
        lookahead_cycles: how many cycles ahead the gate decides, 1 if an admission is due in the next one.
    """

    def __init__(self, lookahead_cycles: int) -> None:
        self._lookahead_cycles = lookahead_cycles
        self._kept: dict[int, Admission] = {}

    def put(self, admission: Admission, cycle: int) -> Refusal | None:
        """Keep an admission, unless it is too old after `cycle` or due later than in the next few."""
        age_cycles, oldest = cycle - admission.cycle, topics.ADMISSION.max_age_cycles or 0
        if not -self._lookahead_cycles < age_cycles <= oldest:
            return Refusal.LATE
        self._kept[max(cycle, admission.cycle)] = admission
        return None

    def take(self, cycle: int) -> Admission | None:
        """The admission that is due in the cycle after `cycle`; it is kept no longer, nor is any before it."""
        due = self._kept.get(cycle)
        self._kept = {later: kept for later, kept in self._kept.items() if later > cycle}
        return due

    def forget(self) -> int:
        """Keep nothing; returns how many admissions were kept."""
        forgotten = len(self._kept)
        self._kept.clear()
        return forgotten

    def snapshot(self) -> tuple[Admission, ...]:
        """Snapshot for `restore`."""
        return tuple(self._kept.values())

    def restore(self, admissions: tuple[Admission, ...], cycle: int) -> None:
        """Keep what another kept after `cycle`."""
        self._kept = {max(cycle, admission.cycle): admission for admission in admissions}
