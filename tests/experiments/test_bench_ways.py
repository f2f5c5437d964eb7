"""Every way of a message into a process and out again is really taken, and told beside the bare socket."""

from __future__ import annotations

import pytest

from deltaq_experiments.bench.ways import MessageWay, ways


@pytest.mark.service
@pytest.mark.nightly
def test_every_way_answers_and_has_its_row() -> None:
    bare, *others = MessageWay
    found = ways(cycles=5)
    assert [row.what for row in found.rows] == others
    for row in found.rows:
        assert row.reference == bare
        assert row.median_us > 0.0
        assert row.kept is None
