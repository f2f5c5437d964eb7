"""The bounds of a follower that is far away, as the page of two sites states them."""

import re
from pathlib import Path
from typing import Any, NamedTuple

_PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "two-sites.md"
_COMMAND = re.compile(r"^python -m (studies\.two_sites --controller qp .*) \$LINK$", re.MULTILINE)
_ERRORS = r"([0-9.]+)°, ([0-9.]+)°, ([0-9.]+) cm"
_ROW = re.compile(rf"^\| `(--delay-s [^`]*)` \| {_ERRORS} \| {_ERRORS} \|$", re.MULTILINE)


class ErrorBound(NamedTuple):
    """What the errors of a run are at most: of the view angle rms and max, of the view distance max."""

    angle_rms_deg: float
    angle_max_deg: float
    distance_max_cm: float

    def is_kept(self, told: dict[str, Any]) -> bool:
        """Whether the figures of a run are within."""
        return (
            told["angle_deg"]["rms"] <= self.angle_rms_deg
            and told["angle_deg"]["max"] <= self.angle_max_deg
            and told["distance_cm"]["max"] <= self.distance_max_cm
        )


class FarBound(NamedTuple):
    """A row of the page: the options of a link, and the bounds in virtual time and over real processes."""

    link: str
    virtual: ErrorBound
    real: ErrorBound


def _bounds(page: str) -> list[FarBound]:
    return [
        FarBound(link, ErrorBound(*map(float, told[:3])), ErrorBound(*map(float, told[3:])))
        for link, *told in _ROW.findall(page)
    ]


BOUNDS = _bounds(_PAGE.read_text(encoding="utf-8"))
(_WORDS,) = _COMMAND.findall(_PAGE.read_text(encoding="utf-8"))


def module_and_options(bound: FarBound, seed: int) -> tuple[str, list[str]]:
    """The module of the page's command, and its options for a link and a seed."""
    module, *options = _WORDS.split()
    return module, [*options, *bound.link.split(), "--seed", f"{seed}"]
