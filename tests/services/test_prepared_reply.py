"""Replies that are prepared: the same bytes as are decided, whatever comes, and none where anything is unusual."""

import numpy as np
import pytest
from krc_side import FR, MAX_DV
from prepared_storm import AnsweredStorm, PreparedKrcSide, RestlessStorm, storms

from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.mode_probe import ADRIFT
from deltaq_services.robot_server.probe_trial import pulse_sums


@pytest.mark.by_day(1)
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
    assert prepared.prompt > 0.3 * telegrams
    for counter in ("admissions", "braked_cycles", "telegrams_implausible", "session_restarted"):
        assert prepared.counters[counter] > 0, counter


def rested():
    """A KRC whose robot rests for longer than its drives may lag."""
    krc = PreparedKrcSide().begin()
    for _ in range(60):
        krc.cycle()
    assert krc.server.at_rest
    assert krc.server.state.phase is Phase.READY
    return krc


def test_a_robot_that_rests_as_it_should_is_set_in_motion_by_a_prepared_reply():
    krc = rested()
    before = krc.prompt
    answer = krc.cycle(krc.admission(MAX_DV))
    assert krc.prompt == before + 1
    assert answer.correction == pytest.approx(MAX_DV, abs=2e-8)


@pytest.mark.parametrize("far", [1.001, 1.5])
def test_a_robot_that_is_not_where_it_was_sent_is_not_set_in_motion_by_a_prepared_reply(far):
    krc = rested()
    before, correction = krc.prompt, krc.correction
    off = np.zeros(6)
    off[2] = far * FR.tracking_tolerance[2]
    answer = krc.cycle(krc.admission(MAX_DV), q=krc.q + off)
    assert (krc.server.state.phase, krc.server.state.reason) == (Phase.HELD, ReasonCode.TRACKING_ERROR)
    assert krc.prompt == before
    assert answer.correction == pytest.approx(correction, abs=2e-8)


def test_a_robot_that_drifts_while_it_is_probed_gets_the_stop_and_no_prepared_reply():
    krc = PreparedKrcSide()
    while krc.server.state is None:
        krc.cycle()
    krc.cycle()
    before = krc.prompt
    for _ in range(3):
        assert not krc.stop
        krc.cycle(q=krc.q + 2.0 * ADRIFT * pulse_sums(FR))
    assert krc.stop
    assert krc.prompt == before
