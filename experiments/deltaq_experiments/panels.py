"""A picture as data: panels one above the other, drawn by `deltaq_experiments.figures`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array


@dataclass(frozen=True)
class Curve:
    """One curve.

    Attributes:
        label: for the legend; empty for none.
        time_s: (k,) abscissa.
        values: (k,) ordinate.
        style: of the line, as matplotlib writes it.
    """

    label: str
    time_s: Array
    values: Array
    style: str = "-"


@dataclass(frozen=True)
class Marks:
    """Times at which something holds, marked along the bottom of a panel.

    Attributes:
        label: for the legend.
        time_s: (k,) abscissa.
        holds: (k,) where it does.
    """

    label: str
    time_s: Array
    holds: NDArray[np.bool_]


@dataclass(frozen=True)
class FigurePanel:
    """One pair of axes.

    Attributes:
        caption: what it shows.
        unit: of the ordinate.
        lines: its curves.
        marks: what is marked.
        bound: a horizontal line that the paper claims, None for none.
    """

    caption: str
    unit: str
    lines: tuple[Curve, ...]
    marks: tuple[Marks, ...] = ()
    bound: float | None = None
