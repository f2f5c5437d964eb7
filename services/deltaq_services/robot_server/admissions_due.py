"""Admissions that have come before the cycle in which they are due."""

from __future__ import annotations

from deltaq_protocol.guarded import Admission


class AdmissionsDue:
    """Keeps admissions until their cycle, one for each of the next few; the newest counts.

    Args:
        lookahead_cycles: how many cycles ahead the gate decides, 1 if an admission is due in the next one.
    """

    def __init__(self, lookahead_cycles: int) -> None:
        self._lookahead_cycles = lookahead_cycles
        self._kept: dict[int, Admission] = {}

    def put(self, admission: Admission, cycle: int) -> bool:
        """Keep an admission; returns whether it is due in the cycle after `cycle`, or in one of the next few."""
        if not 0 <= admission.cycle - cycle < self._lookahead_cycles:
            return False
        self._kept[admission.cycle] = admission
        return True

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

    def restore(self, admissions: tuple[Admission, ...]) -> None:
        """Keep what another kept."""
        self._kept = {admission.cycle: admission for admission in admissions}
