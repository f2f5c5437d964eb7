"""The table of topics with a row changed, for tests that what it says is what is done."""

from dataclasses import replace
from typing import Any

import pytest

from deltaq_protocol import topics
from deltaq_protocol.topic import Topic


def change_row(patch: pytest.MonkeyPatch, row: str, **changes: Any) -> Topic:
    """Change a row by the name that the code has for it, wherever it is looked up from now on."""
    before: Topic = getattr(topics, row)
    after = replace(before, **changes)
    patch.setattr(topics, row, after)
    patch.setattr(topics, "TOPICS", tuple(after if topic is before else topic for topic in topics.TOPICS))
    return after
