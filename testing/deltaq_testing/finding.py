"""What an assertion about a cell found, and why: `assert cell.kept_clear()` says it where it fails."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RunFinding:
    """The result of a check; true if the check holds.

    Attributes:
        good: whether the check holds.
        told: what was measured, and what was allowed.
    """

    good: bool
    told: str

    def __bool__(self) -> bool:
        """Whether the check holds."""
        return self.good

    def __repr__(self) -> str:
        """What pytest shows of it."""
        return f"<{'yes' if self.good else 'no'}: {self.told}>"


@dataclass(frozen=True)
class JointTrackingError:
    """Error of a robot against a reference: that of the joint that is furthest off [rad or m].

    Attributes:
        max: at any time.
        rms: root mean square over time.
        final: in the end.
    """

    max: float
    rms: float
    final: float
