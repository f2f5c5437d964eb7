"""Telegrams by the million: whatever comes, a correction changes only where an admission or its brake explains it."""

import pytest
from telegram_storm import Storm


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
def test_no_telegram_moves_the_robot(seed):
    storm = Storm(seed)
    storm.run(8_000)
    assert storm.answers > 2_500
    assert storm.admitted > 1_000
    assert storm.krc.counters["session_restarted"] >= storm.sessions
    for counter in ("telegrams_implausible", "reply_missed", "braked_cycles"):
        assert storm.krc.counters[counter] > 0, counter


@pytest.mark.nightly
@pytest.mark.timeout(0)
@pytest.mark.parametrize("seed", range(1000, 1020))
def test_no_telegram_of_ten_million_moves_the_robot(seed):
    storm = Storm(seed)
    storm.run(500_000)
    assert storm.sessions > 0
