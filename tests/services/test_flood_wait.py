"""Who is kept waiting, by a clock that the test turns."""

import pytest

from deltaq_services.hli import zenoh_session
from deltaq_services.hli.zenoh_session import FloodWait


class Clock:
    """Time passes while somebody waits, and when the test says so."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.waits = 0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, wait_s: float) -> None:
        self.now_s += wait_s
        self.waits += 1


def test_occasional_messages_never_wait_and_a_flood_is_slowed_down(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Clock()
    monkeypatch.setattr(zenoh_session, "time", clock)
    polite = FloodWait(100.0)
    for _ in range(1000):
        clock.now_s += 0.0101
        polite.one_more()
    assert clock.waits == 0
    flooded, begin_s, messages = FloodWait(100.0), clock.now_s, 0
    while clock.now_s < begin_s + 10.0:
        flooded.one_more()
        messages += 1
    assert messages <= 100 + 10 * (100 + 1 / 0.004)
    assert clock.waits >= 2000
