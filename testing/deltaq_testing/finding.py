"""What an assertion about a cell found, and why: `assert cell.kept_clear()` says it where it fails."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RunFinding:
    """The answer to a question about a run; true if what was asked for was so.

    Attributes:
        good: whether it was.
        told: what was measured, and what was allowed.
    """

    good: bool
    told: str

    def __bool__(self) -> bool:
        """Whether it was so."""
        return self.good

    def __repr__(self) -> str:
        """What pytest shows of it."""
        return f"<{'yes' if self.good else 'no'}: {self.told}>"


@dataclass(frozen=True)
class JointTrackingError:
    """How far a robot was from where it should have been: the largest joint's error [rad or m].

    Attributes:
        max: at any time.
        rms: root mean square over time.
        final: in the end.
    """

    max: float
    rms: float
    final: float
