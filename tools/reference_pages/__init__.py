"""Writes `docs/reference` from the code: `make docs`.

Every page follows from a table or a model, so that none can fall behind; a test holds the committed pages.
"""

from pathlib import Path

from reference_pages import robots, testing, wire

FOLDER = Path(__file__).parents[2] / "docs"
_WRITTEN = "<!-- Written by `make docs` from the code; do not edit. -->\n\n"


PAGES = {
    "reference/cli.md": robots.cli,
    "reference/cell.md": robots.cell,
    "reference/topics.md": wire.topics,
    "reference/messages.md": wire.messages,
    "reference/reasons.md": wire.reasons,
    "reference/counters.md": wire.counters,
    "reference/krc.md": robots.krc,
    "reference/criteria.md": robots.criteria,
    "reference/testing.md": testing.testing,
    "notes/gains.md": robots.gains,
}
"""What writes each page, by its place in `docs`."""


def page(name: str) -> str:
    """A page, as `docs` has it."""
    return _WRITTEN + PAGES[name]().rstrip() + "\n"
