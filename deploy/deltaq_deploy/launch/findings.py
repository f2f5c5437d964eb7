"""Findings of `deltaq doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Rating(StrEnum):
    """Good; works but not at its best; will not work."""

    GOOD = "good"
    FAIR = "fair"
    BAD = "bad"


@dataclass(frozen=True)
class DoctorFinding:
    """One check; advice is empty where nothing needs to be done."""

    what: str
    found: str
    verdict: Rating
    advice: str = ""
