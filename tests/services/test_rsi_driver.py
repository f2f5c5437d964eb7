"""RSI as the Robot Server reads it: sessions, missed replies, and joining one that is under way."""

import numpy as np
import pytest

from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.load import load_cell
from deltaq_protocol.rsi import AxisMap, KrcCodec, KrcReport, SensorCodec, TelegramError, load_ethernet_xml
from deltaq_services.robot_server.rsi_driver import RsiDriver

CELL = load_cell("lab")
FR = CELL.robots["fr"]
CONFIG = load_ethernet_xml(resolve_near(find_cell("lab"), FR.driver.ethernet_xml))
AXES = AxisMap.of(FR.joint_names, FR.units, FR.driver.krc)
KRC = KrcCodec(CONFIG, AXES, FR.driver.inputs, FR.driver.outputs, 4)
STEP = np.full(6, np.deg2rad(1.0))


def telegram(ipoc, q=FR.home, programmed=FR.home, delay=0):
    pose = (0.0,) * 6
    return KRC.encode(KrcReport(ipoc, q, programmed, pose, pose, delay, dict.fromkeys(FR.inputs, False)))


@pytest.fixture
def driver():
    return RsiDriver(SensorCodec(CONFIG, AXES, FR.driver.inputs, FR.driver.outputs), CELL.cycle_s)


def correction(driver, q_cmd):
    return KRC.decode(driver.reply(q_cmd, {})).correction


def test_a_session_starts_where_the_robot_stands_with_no_correction(driver):
    measured = driver.read(telegram(1000))
    np.testing.assert_allclose(measured.q_start, FR.home, atol=1e-6)
    np.testing.assert_allclose(correction(driver, measured.q_start), 0.0, atol=1e-8)


def test_the_session_goes_on_while_the_ipoc_does(driver):
    driver.read(telegram(1000))
    assert driver.read(telegram(1012)).q_start is None
    assert driver.read(telegram(1036)).q_start is None  # one telegram was lost on the way


def test_corrections_are_offsets_from_the_programmed_path_whatever_is_measured(driver):
    driver.read(telegram(1000))
    driver.read(telegram(1012, q=FR.home + 0.3 * STEP))
    np.testing.assert_allclose(correction(driver, FR.home + STEP), STEP, atol=1e-8)


@pytest.mark.parametrize("ipoc", [500, 1007, 1000 + 12 * 200])
def test_an_ipoc_that_leaps_begins_a_new_session(driver, ipoc):
    driver.read(telegram(1000))
    assert driver.read(telegram(ipoc)).q_start is not None


def test_a_telegram_that_comes_twice_or_late_is_not_answered_and_ends_no_session(driver):
    driver.read(telegram(1000))
    driver.read(telegram(1012))
    assert driver.read(telegram(1012)) is None
    assert driver.read(telegram(1000)) is None
    assert driver.ipoc == 1012
    assert driver.read(telegram(1024)).q_start is None


def test_an_ipoc_that_stays_behind_is_a_clock_set_back_and_begins_a_new_session(driver):
    driver.read(telegram(1000))
    driver.read(telegram(1012))
    assert driver.read(telegram(952)) is None
    assert driver.read(telegram(964)).q_start is not None


def test_the_ipoc_may_wrap_within_a_session(driver):
    driver.read(telegram(2**32 - 4))
    assert driver.read(telegram(8)).q_start is None


def test_a_programmed_path_that_moved_begins_a_new_session(driver):
    driver.read(telegram(1000))
    measured = driver.read(telegram(1012, q=FR.home + STEP, programmed=FR.home + STEP))
    np.testing.assert_allclose(measured.q_start, FR.home + STEP, atol=1e-6)


def test_a_delay_that_grew_says_that_the_last_reply_was_missed(driver):
    assert not driver.read(telegram(1000, delay=3)).missed_last
    assert not driver.read(telegram(1012, delay=3)).missed_last
    assert driver.read(telegram(1024, delay=4)).missed_last
    assert not driver.read(telegram(1036, delay=4)).missed_last


def test_a_session_joined_in_motion_is_not_answered_before_the_robot_stands(driver):
    for count in range(1, 4):
        assert driver.read(telegram(1000 + 12 * count, q=FR.home + count * STEP)) is None
    assert driver.opening_reply is None
    measured = driver.read(telegram(1048, q=FR.home + 3 * STEP))
    np.testing.assert_allclose(measured.q_start, FR.home + 3 * STEP, atol=1e-6)
    np.testing.assert_allclose(correction(driver, measured.q_start), 3 * STEP, atol=1e-6)


def test_the_first_telegram_of_a_kr_c2_is_answered_with_no_correction(driver):
    assert driver.read(KRC.encode_ipoc_only(1000)) is None
    reply = KRC.decode(driver.opening_reply)
    assert reply.ipoc == 1000
    np.testing.assert_array_equal(reply.correction, np.zeros(6))
    assert driver.read(telegram(1012)).q_start is not None


def test_what_is_no_telegram_is_an_error_and_changes_nothing(driver):
    driver.read(telegram(1000))
    with pytest.raises(TelegramError):
        driver.read(b"<Rob Type='nobody'>")
    assert driver.read(telegram(1012)).q_start is None
