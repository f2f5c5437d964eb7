"""Writes `docs/reference` from the code: `make docs`.

Every page follows from a table or a model, so that none can fall behind; a test holds the committed pages.
"""

from __future__ import annotations

from pathlib import Path

from reference_pages import robots, rooms, sequences, testing, wire

FOLDER = Path(__file__).parents[2] / "docs" / "reference"
_WRITTEN = "<!-- Written by `make docs` from the code; do not edit. -->\n\n"


PAGES = {
    "topics.md": wire.topics,
    "sayings.md": wire.sayings,
    "messages.md": wire.messages,
    "reasons.md": wire.reasons,
    "counters.md": wire.counters,
    "phases.md": robots.phases,
    "krc.md": robots.krc,
    "rsi-sessions.md": robots.sessions,
    "criteria.md": robots.criteria,
    "gains.md": robots.gains,
    "cell.md": robots.cell,
    "services.md": robots.services,
    "cli.md": robots.cli,
    "testing.md": testing.testing,
    "rooms.md": rooms.rooms,
    "sequences.md": sequences.sequences,
}
"""What writes each page, by file name."""


def page(name: str) -> str:
    """A page, as `docs/reference` has it."""
    return _WRITTEN + PAGES[name]().rstrip() + "\n"
