"""What self-contained HTML reports are made of: page, table, and figures as SVG in the page's colours."""

from __future__ import annotations

import io
import re
from collections.abc import Collection, Iterable
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltaq_protocol.arrays import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Cells = Iterable[str]

_STYLE = Path(__file__).with_suffix(".css")

COLOURS = {
    "text": "#010101",
    "soft": "#020202",
    "rule": "#030303",
    "ready": "#040404",
    "engaged": "#050505",
    "braking": "#060606",
    "held": "#070707",
    "offline": "#080808",
    "line": "#090909",
    "second": "#0a0a0a",
}
"""Stand-ins for the page's colours: matplotlib wants colours, and a page in light and dark has variables."""

_NAMES = {colour: name for name, colour in COLOURS.items()}
_STAND_IN = re.compile("|".join(_NAMES))
_USED_ID = re.compile(r'(?:href="|url\()#([^")]+)')
_FONT = re.compile(r"(font(?:-family)?:[^;\"]*?)'DejaVu Sans'[^;\"]*")


def document(title: str, parts: Iterable[str]) -> str:
    """A self-contained page in the style of the reports; `parts` are escaped already."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{_STYLE.read_text(encoding='utf-8')}</style>\n</head>\n"
        f"<body>\n<main>\n{chr(10).join(parts)}\n</main>\n</body>\n</html>\n"
    )


def table(columns: Cells, rows: Iterable[Cells], numbers: Collection[int] = ()) -> str:
    """A table of a page; the columns at the places `numbers` are aligned as such."""

    def cells(tag: str, texts: Cells) -> str:
        return "".join(
            f'<{tag} class="number">{escape(text)}</{tag}>'
            if place in numbers
            else f"<{tag}>{escape(text)}</{tag}>"
            for place, text in enumerate(texts)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{cells("th", columns)}</tr></thead><tbody>{body}</tbody></table></div>'


def settings(name: str) -> dict[Any, Any]:
    """Of matplotlib, for a figure of this name, which no other figure of the page has."""
    return {
        "svg.fonttype": "none",  # text stays text: it can be searched, and takes the page's type
        "svg.hashsalt": name,  # the same run gives the same page
        "text.parse_math": False,  # a dollar sign in a name is a dollar sign
        "text.color": COLOURS["text"],
        "axes.labelcolor": COLOURS["soft"],
        "axes.edgecolor": COLOURS["rule"],
        "xtick.color": COLOURS["soft"],
        "ytick.color": COLOURS["soft"],
        "grid.color": COLOURS["rule"],
        "font.size": 9,
        "axes.linewidth": 0.7,
        "path.simplify": False,
    }


def inlined(figure: Figure, title: str) -> str:
    """The figure as an `svg` element.

    Args:
        figure: drawn with `COLOURS` under `settings`.
        title: text for screen readers; escaped already.
    """
    text = io.StringIO()
    figure.savefig(text, format="svg", transparent=True, metadata={"Date": None})
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    svg = (
        re.sub(r'\s(?:xmlns(?::\w+)?|version|width|height)="[^"]*"', "", svg[: svg.index(">")])
        + svg[svg.index(">") :]
    )
    svg = svg.replace("xlink:href", "href")
    used = set(_USED_ID.findall(svg))
    svg = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in used else "", svg)
    svg = _FONT.sub(r"\1inherit-family", svg).replace("inherit-family", "var(--type)")
    svg = _STAND_IN.sub(lambda found: f"var(--{_NAMES[found[0]]})", svg)
    return svg.replace("<svg", f'<svg role="img" aria-label="{title}"', 1)


def outline(time_s: Array, values: Array, columns: int = 700) -> tuple[Array, Array]:
    """A long curve with as many points as a picture can show: the extremes of each column, in their order.

    Args:
        time_s: (k,) abscissa, not decreasing.
        values: (k,) ordinate.
        columns: of the picture.

    Returns:
        Abscissa and ordinate of at most `2 * columns` points; the extremes of the curve are among them.
    """
    if len(values) <= 2 * columns:
        return time_s, values
    edges = np.linspace(0, len(values), columns + 1).astype(int)
    kept = np.empty(2 * columns, dtype=int)
    for column, (first, end) in enumerate(pairwise(edges.tolist())):
        part = values[first:end]
        kept[2 * column : 2 * column + 2] = sorted((first + int(part.argmin()), first + int(part.argmax())))
    return time_s[kept], values[kept]
