"""Replies that are prepared: the same bytes as are decided, whatever comes, and none where anything is unusual."""

import pytest
from prepared_storm import AnsweredStorm, RestlessStorm, storms


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "seed", "telegrams"),
    [
        (AnsweredStorm, 11, 2_000),
        (RestlessStorm, 12, 4_000),
        pytest.param(AnsweredStorm, 13, 100_000, marks=[pytest.mark.nightly, pytest.mark.timeout(0)]),
        pytest.param(RestlessStorm, 14, 100_000, marks=[pytest.mark.nightly, pytest.mark.timeout(0)]),
    ],
)
def test_a_storm_is_answered_with_the_same_bytes_whether_replies_are_prepared_or_not(
    monkeypatch, kind, seed, telegrams
):
    decided, prepared = storms(monkeypatch, kind, seed, telegrams)
    assert prepared.answers == decided.answers
    assert prepared.counters == decided.counters
    print(prepared.prompt)
    assert prepared.prompt > 0.3 * telegrams
    for counter in ("admissions", "braked_cycles", "telegrams_implausible", "session_restarted"):
        assert prepared.counters[counter] > 0, counter
