"""A storm on RSI's wire of real processes: each correction is an admission, its brake, a probe, or the last again."""

import pytest

from deltaq_proofs.storm.run import run_storm
from deltaq_proofs.storm.witness import UNHEARD
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.private_cell import write_private_cell

pytestmark = pytest.mark.live

RATE_HZ = 2000.0


def storm(folder, telegrams):
    report = run_storm(load_rsi_cell(write_private_cell(folder)), "fr", telegrams, RATE_HZ)
    assert report.unexplained is None
    assert report.forged == telegrams
    assert report.replies.get(UNHEARD, 0) <= report.unheard <= report.admissions / 10
    assert report.server["telegrams_garbled"] > telegrams / 50
    assert report.server["telegrams_second_krc"] > telegrams / 4
    return report


@pytest.mark.nightly
def test_no_datagram_of_six_thousand_moves_a_robot_that_a_controller_moves(tmp_path):
    report = storm(tmp_path, 6_000)
    assert report.replies["by an admission"] > 10
    assert report.replies["by a brake"] > 0
    assert report.replies["by a probe"] > 0


@pytest.mark.nightly
@pytest.mark.timeout(0)
def test_no_datagram_of_a_million_moves_a_robot_that_a_controller_moves(tmp_path):
    report = storm(tmp_path, 1_000_000)
    assert report.replies["by an admission"] > 1000
    assert report.replies["sessions"] > 1
