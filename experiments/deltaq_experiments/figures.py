"""Draw the panels of an experiment to a file; needs no display."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
        caption: its title.
        unit: of the ordinate.
        lines: its curves.
        marks: points or times that are marked.
        bound: a horizontal line that the paper claims, None for none.
    """

    caption: str
    unit: str
    lines: tuple[Curve, ...]
    marks: tuple[Marks, ...] = ()
    bound: float | None = None


def distance_panel(
    time_s: Array, distance_m: Array, desired_m: Array | float, marks: tuple[Marks, ...] = ()
) -> FigurePanel:
    """View distance (k,) beside the desired one."""
    desired = Curve("desired", time_s, np.broadcast_to(desired_m, time_s.shape), "--")
    return FigurePanel("View distance", "m", (Curve("distance", time_s, distance_m), desired), marks)


WIDTH_IN, PANEL_IN = 7.0, 2.1
MARK_COLOURS = ("tab:red", "tab:purple", "tab:brown")


def draw(panels: Sequence[FigurePanel], title: str, file: str | Path) -> None:
    """Write a picture; the suffix of its name selects the format (png, pdf, svg).

    Raises:
        DeltaqError: the file cannot be written, or its format is none.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, PANEL_IN * len(panels) + 0.7), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    axes: Any = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for letter, panel, ax in zip("abcdef", panels, axes[:, 0], strict=False):
        _draw_panel(ax, f"({letter}) {panel.caption}", panel)
    axes[-1, 0].set_xlabel("time [s]")
    save(figure, file)


def save(figure: Figure, file: str | Path) -> None:
    """Write a drawn figure; the suffix of the file's name selects the format.

    Raises:
        DeltaqError: the file cannot be written, or its format is none.
    """
    try:
        # no dates and no program's name: the same run gives the same file
        figure.savefig(file, metadata={"Software": None} if str(file).endswith(".png") else {})
    except (OSError, ValueError) as error:
        raise DeltaqError(f"--figure {file}: {error}; give a writable FILE.png, .pdf or .svg") from None


def _draw_panel(ax: Axes, caption: str, panel: FigurePanel) -> None:
    for line in panel.lines:
        ax.plot(line.time_s, line.values, line.style, linewidth=1.1, label=line.label or None)
    if panel.bound is not None:
        ax.axhline(panel.bound, color="0.6", linewidth=0.8, linestyle="--")
    for place, (mark, colour) in enumerate(zip(panel.marks, MARK_COLOURS, strict=False)):
        _draw_marks(ax, mark, 0.03 + 0.05 * place, colour)
    ax.set_title(caption, fontsize=9, loc="left")
    ax.set_ylabel(f"[{panel.unit}]")
    ax.grid(color="0.9")
    if ax.get_legend_handles_labels()[1]:
        ax.legend(fontsize=7, loc="upper right", ncols=4)


def _draw_marks(ax: Axes, mark: Marks, height: float, colour: str) -> None:
    when = mark.time_s[np.flatnonzero(mark.holds)]
    # heights in parts of the panel, times in those of the axis
    transform = ax.get_xaxis_transform()
    ax.plot(when, np.full(len(when), height), "s", color=colour, markersize=2.5, transform=transform,
            label=mark.label)  # fmt: skip
