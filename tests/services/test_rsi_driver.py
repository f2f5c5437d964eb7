"""RSI as the Robot Server reads it: what is believed, what is answered, and that no telegram moves the robot."""

import math
import random
import re

import numpy as np
import pytest
from krc_side import CELL, FR, KRC, MAX_DV, XML, KrcSide, telegram

from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.rsi import TelegramError
from deltaq_services.robot_server.cycle_meter import DRIFT, SLOW_WINDOWS, WINDOW_TICKS, CycleMeter
from deltaq_services.robot_server.probe_trial import PROBE_RAD
from deltaq_services.robot_server.session import CONFIRMATIONS, Belief

STEP = np.full(6, np.deg2rad(1.0))
SILENCE = math.ceil(CELL.gate.krc_timeout_s / CELL.cycle_s)
PROBED = 1.01 * PROBE_RAD
"""How far from a correction the probe of a session's mode may go [rad]."""
OFF = np.array([np.deg2rad(1.4), 0, 0, 0, 0, 0])


@pytest.fixture
def krc():
    return KrcSide().begin()


def test_a_session_is_believed_after_agreeing_telegrams_without_correction_until_then():
    krc = KrcSide()
    for _ in range(CONFIRMATIONS - 1):
        np.testing.assert_array_equal(krc.cycle().correction, np.zeros(6))
        assert krc.driver.session.belief is Belief.UNKNOWN
    np.testing.assert_array_equal(krc.cycle().correction, np.zeros(6))
    assert krc.driver.session.belief is Belief.BELIEVED
    np.testing.assert_allclose(krc.server.state.q_cmd, FR.home, atol=1e-6)


def test_a_session_waits_for_a_moving_robot():
    krc = KrcSide()
    for count in range(2 * CONFIRMATIONS):
        krc.cycle(q=FR.home + count * 0.1 * STEP)
    assert krc.driver.session.belief is Belief.UNKNOWN
    assert krc.server.state is None


def test_a_session_survives_lost_telegrams(krc):
    krc.tick(5)
    assert krc.cycle() is not None
    assert krc.counters["session_restarted"] == 0


def test_corrections_are_offsets_from_the_programmed_path_not_from_measurements(krc):
    krc.cycle(q=FR.home + 0.3 * STEP)
    told = KRC.decode(krc.driver.reply(krc.driver.q_sent + STEP, {}))
    np.testing.assert_allclose(told.correction, STEP, atol=1e-8)


def test_the_two_datagrams_that_moved_the_arm_move_nothing(krc):
    krc.drive()
    before = krc.correction
    for _ in range(20):
        krc.hand(telegram(krc.ipoc + 12 * 5000, krc.q + OFF))
        krc.hand(telegram(krc.ipoc, krc.q + OFF))
        krc.cycle()
        np.testing.assert_array_equal(krc.correction, before)
    assert krc.counters["session_restarted"] == 0


def test_a_forged_session_is_not_believed_during_the_true_one(krc):
    krc.drive()
    before = krc.correction
    for _ in range(20):
        for count in range(10):
            krc.hand(telegram(5_000_000 + 12 * count, FR.home, FR.home))
            krc.hand(telegram(9_000_000 + 12 * count, FR.home + OFF, FR.home + OFF))
        krc.cycle()
    np.testing.assert_array_equal(krc.correction, before)
    assert krc.counters["session_restarted"] == 0


def test_a_forged_session_is_not_believed_during_losses_of_the_true_one(krc):
    krc.drive()
    before = krc.correction
    for count in range(SILENCE - 1):
        krc.tick()
        krc.hand(telegram(5_000_000 + 12 * count, FR.home, FR.home))
    krc.cycle()
    np.testing.assert_array_equal(krc.correction, before)
    assert krc.counters["session_restarted"] == 0


def test_a_fast_burst_of_agreeing_telegrams_is_no_session():
    krc = KrcSide()
    krc.tick()
    for count in range(10):
        krc.hand(telegram(1000 + 12 * count))
    assert krc.driver.session.belief is Belief.UNKNOWN


def test_a_new_rsi_session_is_not_answered_with_a_jump_back(krc):
    krc.drive()
    assert krc.hand(KRC.encode_ipoc_only(krc.ipoc)) is None
    before = krc.correction
    krc.cycle()
    np.testing.assert_array_equal(krc.correction, before)


@pytest.mark.parametrize("leap", [-5000, 7, 12 * 5000])
def test_a_permanently_jumping_ipoc_is_another_session_at_the_same_place(krc, leap):
    krc.drive()
    before = krc.correction
    krc.ipoc += leap
    for _ in range(SILENCE + CONFIRMATIONS):
        krc.cycle()
        np.testing.assert_allclose(krc.correction, before, atol=PROBED)
    assert krc.counters["session_restarted"] == 1
    np.testing.assert_allclose(krc.probed().correction, before, atol=1e-8)


def test_a_clock_set_back_a_little_moves_nothing_until_it_has_caught_up(krc):
    krc.drive()
    before = krc.correction
    krc.ipoc -= 48
    for _ in range(10):
        krc.cycle()
        np.testing.assert_array_equal(krc.correction, before)
    assert krc.counters["session_restarted"] == 0
    assert krc.driver.session.belief is Belief.BELIEVED


def test_repeated_and_late_telegrams_are_not_answered_and_end_no_session(krc):
    before = krc.own()
    krc.cycle()
    assert krc.hand(krc.own()) is None
    assert krc.hand(before) is None
    assert krc.cycle() is not None
    assert krc.counters["session_restarted"] == 0


def test_one_garbled_stamp_ends_no_session(krc):
    krc.tick()
    krc.hand(telegram(krc.ipoc + 12 * 3))
    for _ in range(8):
        krc.cycle()
    krc.hand(telegram(krc.ipoc + 12 * 20))
    for _ in range(8):
        assert krc.cycle() is not None
    assert krc.counters["session_restarted"] == 0


def test_the_ipoc_may_wrap_within_a_session():
    krc = KrcSide()
    krc.ipoc = 2**32 - 100
    krc.begin()
    for _ in range(20):
        assert krc.cycle() is not None
    assert krc.counters["session_restarted"] == 0


@pytest.mark.parametrize("step", [1, 12, 48])
def test_the_step_of_the_ipoc_is_learned(step):
    krc = KrcSide(step=step).begin()
    assert krc.driver.session.step == step
    for _ in range(20):
        assert krc.cycle() is not None
    krc.tick(3)
    assert krc.cycle() is not None
    assert krc.hand(krc.own()) is None
    assert krc.counters["session_restarted"] == 0


def cell_with(**fields):
    driver = FR.driver.model_copy(update=fields)
    robots = {**CELL.robots, "fr": FR.model_copy(update={"driver": driver})}
    return CELL.model_copy(update={"robots": robots})


def test_with_a_configured_ipoc_step_no_other_is_believed():
    krc = KrcSide(step=12, cell=cell_with(ipoc_step=1)).begin()
    assert krc.driver.session.belief is Belief.UNKNOWN
    krc = KrcSide(step=1, cell=cell_with(ipoc_step=1)).begin()
    assert krc.driver.session.belief is Belief.BELIEVED


def test_a_program_started_again_elsewhere_is_a_session_without_correction(krc):
    krc.drive()
    krc.tick(100)
    krc.q_programmed, krc.correction = krc.q + 0.2 * STEP, np.zeros(6)
    for _ in range(SILENCE + CONFIRMATIONS):
        krc.cycle()
        np.testing.assert_allclose(krc.correction, np.zeros(6), atol=PROBED)
    assert krc.counters["session_restarted"] == 1
    np.testing.assert_array_equal(krc.probed().correction, np.zeros(6))


def test_a_program_restarted_at_home_does_not_get_its_old_correction(krc):
    krc.drive()
    krc.tick(200)
    krc.correction = np.zeros(6)
    for _ in range(SILENCE + CONFIRMATIONS):
        krc.cycle()
        np.testing.assert_allclose(krc.correction, np.zeros(6), atol=PROBED)
    np.testing.assert_array_equal(krc.probed().correction, np.zeros(6))


def test_a_session_at_an_unexplained_place_is_not_answered(krc):
    krc.drive()
    krc.tick(200)
    for _ in range(20):
        assert krc.cycle(q=FR.home + 3 * STEP) is None
    assert "neither where it was sent nor" in krc.driver.detail


def test_a_restarted_server_adopts_the_krcs_correction_once_the_robot_rests():
    krc = KrcSide()
    krc.correction = 3 * STEP
    for count in range(3):
        assert krc.cycle(q=krc.q + 0.1 * (3 - count) * STEP) is None
    for _ in range(CONFIRMATIONS):
        krc.cycle()
    np.testing.assert_allclose(krc.correction, 3 * STEP, atol=2e-6)
    np.testing.assert_allclose(krc.server.state.q_cmd, krc.q, atol=2e-6)


def test_one_flipped_digit_of_the_programmed_position_moves_nothing(krc):
    krc.drive()
    before = krc.correction
    told = krc.cycle(programmed=FR.home + 30 * OFF / 1.4)
    np.testing.assert_array_equal(told.correction, before)
    assert krc.counters["telegrams_implausible"] == 1


@pytest.mark.parametrize("ipoc", [2**32, 123645634563, 10**20 - 1])
def test_an_ipoc_beyond_32_bit_is_implausible_and_gets_no_answer(krc, ipoc):
    own = krc.codec.encode_ipoc_only(krc.ipoc)
    for datagram in (krc.own(), own):
        assert krc.hand(datagram.replace(b"%d<" % krc.ipoc, b"%d<" % ipoc)) is None
    assert krc.counters["telegrams_implausible"] == 2
    assert krc.driver.implausible == f"IPOC is {ipoc}, and a KRC's has 32 bit: at most 4294967295"
    assert krc.cycle() is not None
    assert krc.counters["session_restarted"] == 0


def test_without_the_programmed_position_a_session_begins_where_the_robot_is_and_its_mode_is_probed(tmp_path):
    xml = tmp_path / "without.xml"
    xml.write_text(re.sub(r".*DEF_ASPos.*\n", "", XML.read_text()))
    krc = KrcSide(xml=xml)
    assert b"ASPos" not in krc.own()
    krc.begin()
    assert krc.driver.session.belief is Belief.BELIEVED
    assert krc.server.detail == ""
    krc.drive()
    np.testing.assert_allclose(krc.server.state.q_cmd, krc.q, atol=1e-6)
    assert np.all(np.abs(krc.correction) > PROBED)


@pytest.mark.parametrize("flipped", [b"AIPos", b"Delay"])
def test_without_the_programmed_position_no_flipped_digit_moves_the_robot(tmp_path, flipped):
    xml = tmp_path / "without.xml"
    xml.write_text(re.sub(r".*DEF_ASPos.*\n", "", XML.read_text()))
    krc = KrcSide(xml=xml).begin().drive()
    before = krc.correction
    begin = krc.own().index(flipped)
    digits = [match.start() for match in re.finditer(rb"(?<=[\d.\"-])\d", krc.own())]
    digits = [at for at in digits if begin < at < krc.own().index(b"/>", begin)]
    assert digits
    for at in digits:
        krc.tick()
        told = bytearray(krc.own())
        told[at] = ord("0") + (told[at] - ord("0") + 5) % 10
        krc.hand(bytes(told))
        np.testing.assert_allclose(krc.correction, before, atol=1e-12)
        krc.cycle()
        np.testing.assert_allclose(krc.correction, before, atol=1e-12)


@pytest.mark.parametrize(
    ("off_deg", "why"),
    [
        (9_999_999.0, r"a1 is above its limit and a margin: 174\d\d\d, allowed 3\.49159 "),
        (-500.0, r"a1 is below its limit and a margin: -10\.\d+, allowed -3\.49159 "),
        (40.0, r"a1 cannot have moved so far in 1 cycles: 0\.69\d+, allowed 0\.0525088 "),
    ],
)
def test_an_implausible_position_is_counted_logged_and_answered_with_the_last_correction(krc, off_deg, why):
    krc.drive()
    before, state = krc.correction, krc.server.state
    told_why = []
    for count in (1, 2):
        told = krc.cycle(q=krc.q + np.array([np.deg2rad(off_deg), 0, 0, 0, 0, 0]))
        np.testing.assert_array_equal(told.correction, before)
        assert krc.counters["telegrams_implausible"] == count
        told_why.append(krc.driver.implausible)
    assert re.match(why, told_why[0])
    assert told_why[1]
    assert krc.server.state == state  # nobody is told what nobody believes
    krc.cycle()
    assert not krc.driver.implausible


def test_after_lost_telegrams_a_joint_may_be_further_away(krc):
    krc.tick(10)
    krc.cycle(q=FR.home + 10 * OFF)
    assert krc.counters["telegrams_implausible"] == 0


def test_outputs_stay_on_in_answers_that_move_nothing():
    krc = KrcSide().begin()
    krc.cycle()
    krc.driver.reply(krc.driver.q_sent, {})
    assert krc.cycle(q=FR.home + 10 * STEP).outputs == {"stop": False}


def test_a_grown_delay_means_a_missed_reply(krc):
    krc.cycle(delay=3)
    for delay, missed in ((3, False), (4, True), (4, False)):
        krc.tick()
        assert krc.driver.read(krc.own(delay=delay), krc.time_s).missed_last is missed


def test_the_first_telegram_of_a_kr_c2_is_answered_with_no_correction():
    krc = KrcSide()
    krc.tick()
    told = krc.hand(KRC.encode_ipoc_only(krc.ipoc))
    assert told.ipoc == krc.ipoc
    np.testing.assert_array_equal(told.correction, np.zeros(6))
    krc.begin()
    assert krc.driver.session.belief is Belief.BELIEVED


def test_a_jumping_setpoint_is_not_sent_and_holds_the_robot(krc):
    krc.tick()
    assert krc.driver.read(krc.own(), krc.time_s) is not None
    told = KRC.decode(krc.driver.reply(krc.driver.q_sent + 3 * STEP, {}))
    np.testing.assert_array_equal(told.correction, np.zeros(6))
    assert " leaps: " in krc.driver.fault
    np.testing.assert_allclose(krc.driver.q_sent, FR.home, atol=1e-6)


def test_no_correction_goes_beyond_what_the_cell_allows():
    krc = KrcSide(cell=cell_with(max_correction_deg=2.0)).begin().drive()
    state = krc.server.state
    assert (state.phase, state.reason) == (Phase.HELD, ReasonCode.REPLY_REFUSED)
    assert np.degrees(np.abs(krc.correction)).max() < 2.0
    assert krc.driver.fault is None  # it goes on sending what it sent
    krc.resets += 1
    krc.cycle()
    assert krc.server.state.phase is Phase.READY
    np.testing.assert_allclose(krc.server.state.q_cmd, krc.q, atol=1e-8)


def test_an_invalid_telegram_is_an_error_and_changes_nothing(krc):
    with pytest.raises(TelegramError):
        krc.driver.read(b"<Rob Type='nobody'>", krc.time_s)
    assert krc.cycle() is not None
    assert krc.counters["session_restarted"] == 0


def test_a_krc_that_returns_after_another_still_has_its_correction():
    krc = KrcSide().begin()
    krc.cycle(krc.admission(0.05 * MAX_DV))
    for _ in range(20):
        krc.cycle()
    kept = krc.correction.copy()
    assert 0.0 < np.abs(kept / FR.tracking_tolerance).max() < 1.0  # it could be taken for none
    krc.tick(100)
    elsewhere = FR.home + 0.001
    for count in range(CONFIRMATIONS):
        krc.tick()
        krc.answer(telegram(3_000_000 + 12 * count, elsewhere, elsewhere))
    assert krc.counters["session_restarted"] == 1
    krc.tick(100)
    answers = [krc.cycle() for _ in range(2 * CONFIRMATIONS)]
    assert krc.counters["session_restarted"] == 2
    told = [answer for answer in answers if answer is not None]
    assert len(told) > CONFIRMATIONS
    for answer in told[:3]:  # then the probe of the new session begins
        np.testing.assert_allclose(answer.correction, kept, atol=2e-8)
    for answer in told:
        np.testing.assert_allclose(answer.correction, kept, atol=PROBED)


@pytest.mark.parametrize("cycles_of_pulse", [1, 2, 3])
def test_repeatedly_interrupted_probes_do_not_displace_the_robot(krc, cycles_of_pulse):
    krc.drive()
    before, reached = krc.q.copy(), []
    for session in range(1, 13):
        krc.ipoc += 1_000_000  # another session of the same program
        krc.time_s += 1.0
        krc.until(lambda: krc.counters["session_restarted"] == session)  # noqa: B023 - called in this turn
        krc.until(lambda: (krc.q - before > 1e-5).all())
        for _ in range(cycles_of_pulse - 1):
            krc.cycle()
        reached.append(krc.q - before)
    assert krc.counters["session_restarted"] == 12
    assert np.abs(reached).max() <= PROBED
    np.testing.assert_allclose(krc.probed().q, before, atol=1e-8)
    krc.resets += 1
    krc.cycle()
    assert krc.server.state.phase == "ready"
    np.testing.assert_allclose(krc.server.state.q_cmd, before, atol=1e-8)


def test_an_interrupted_pulse_is_undone_when_its_session_returns(krc):
    krc.drive()
    before, programmed, correction = krc.q.copy(), krc.q_programmed.copy(), krc.correction.copy()
    krc.ipoc += 1_000_000
    krc.time_s += 1.0
    krc.until(lambda: (krc.correction - correction > 1e-5).all())
    cut = krc.correction.copy()
    # another program, somewhere else
    krc.q_programmed, krc.correction = FR.home + 0.1, np.zeros(6)
    krc.ipoc += 1_000_000
    krc.time_s += 1.0
    krc.until(lambda: krc.counters["session_restarted"] == 2)
    krc.q_programmed, krc.correction = programmed, cut
    krc.ipoc += 1_000_000
    krc.time_s += 1.0
    krc.until(lambda: krc.counters["session_restarted"] == 3)
    np.testing.assert_allclose(krc.q, before, atol=1e-8)


def test_a_reply_refused_within_a_pulse_does_not_add_the_pulse_to_the_held_setpoint(krc):
    krc.drive()
    before = krc.q.copy()
    krc.ipoc += 1_000_000
    krc.time_s += 1.0
    krc.until(lambda: (krc.q - before > 1e-5).all())
    krc.server.reply_refused(krc.q)
    np.testing.assert_allclose(krc.probed().q, before, atol=1e-8)
    krc.resets += 1
    krc.cycle()
    np.testing.assert_allclose(krc.server.state.q_cmd, before, atol=1e-8)


# The meter of a KRC's cycle, on times that a test makes: what is another cycle, and what is a busy machine.

SILENCE_S = 0.25


def metered(cycle_s, step, times, given=None, ticks=1):
    """A meter that was handed telegrams at these times, each so many ticks after the one before."""
    meter = CycleMeter(cycle_s, SILENCE_S, given)
    first, *others = times
    meter.begin(step, first)
    for time_s in others:
        meter.tick(ticks, time_s)
    return meter


def every(period_s, duration_s):
    return [5.0 + number * period_s for number in range(round(duration_s / period_s) + 1)]


@pytest.mark.parametrize(
    ("cycle_s", "step", "period_s", "told"),
    [
        (0.012, 4, 0.004, "ticks every 4.0 ms by its IPOC and 4.0 ms by the clock, the cell says 12.0 ms"),
        (0.012, 4, 0.012, "ticks every 4.0 ms by its IPOC and 12.0 ms by the clock"),
        (0.012, 12, 0.004, "ticks every 12.0 ms by its IPOC and 4.0 ms by the clock"),
        (0.012, 1, 0.004, "ticks every 4.0 ms by the clock, the cell says 12.0 ms"),
        (0.012, 1, 0.008, "ticks every 8.0 ms by the clock"),
        (0.004, 12, 0.012, "ticks every 12.0 ms by its IPOC and 12.0 ms by the clock, the cell says 4.0 ms"),
        (0.004, 12, 0.0075, "ticks every 12.0 ms by its IPOC and 7.5 ms by the clock"),
    ],
)
def test_another_cycle_is_a_fault_with_both_figures_and_never_known(cycle_s, step, period_s, told):
    meter = CycleMeter(cycle_s, SILENCE_S, None)
    first, *others = every(period_s, 4.0)
    meter.begin(step, first)
    for time_s in others:
        meter.tick(1, time_s)
        assert not meter.known
    assert told in meter.fault
    assert "#IPO" in meter.fault


@pytest.mark.parametrize(
    ("cycle_s", "step", "period_s"),
    [
        (0.012, 12, 0.012),
        (0.004, 4, 0.004),
        (0.012, 1, 0.012),
        (0.004, 1, 0.004),
        (0.004, 4, 0.0072),  # a busy machine
        (0.012, 12, 0.036),
        (0.004, 1, 0.012),
        (0.012, 12, 0.01196),  # clocks that drift
        (0.004, 12, 0.004),  # another count
    ],
)
def test_the_cells_cycle_a_count_and_a_slow_machine_are_no_fault(cycle_s, step, period_s):
    meter = metered(cycle_s, step, every(period_s, 20.0))
    assert (meter.known, meter.fault) == (True, "")
    assert ("a busy machine?" in meter.detail) == (period_s > 1.3 * cycle_s)


def test_a_faster_ipoc_is_a_fault_with_the_first_telegram_of_a_session():
    meter = CycleMeter(0.012, SILENCE_S, None)
    meter.begin(4, 5.0)
    assert meter.fault.startswith("the KRC ticks every 4.0 ms by its IPOC, the cell says 12.0 ms")
    assert "set driver.ipoc_step to 4" in meter.fault
    meter.begin(12, 6.0)
    assert meter.fault == ""


def test_a_configured_ipoc_step_contains_no_time():
    assert metered(0.012, 4, every(0.012, 2.0), given=4).known
    assert "ticks every 4.0 ms by the clock" in metered(0.012, 4, every(0.004, 2.0), given=4).fault


def test_the_cycle_is_known_after_one_window_at_its_pace_and_no_sooner():
    times = every(0.012, 2.0)
    assert not metered(0.012, 12, times[:WINDOW_TICKS]).known
    assert metered(0.012, 12, times[: WINDOW_TICKS + 1]).known
    hurried = [5.0 + number * 0.009 for number in range(WINDOW_TICKS + 1)]
    assert not metered(0.012, 12, hurried).known


def test_a_suddenly_faster_krc_is_a_fault_before_it_gains_half_a_second():
    meter = metered(0.012, 1, every(0.012, 10.0))
    time_s, gained_s = 15.0 + 0.012, 0.0
    meter.tick(1, time_s)
    while not meter.fault:
        time_s += 0.004
        gained_s += 0.008
        meter.tick(1, time_s)
        assert gained_s < 0.5
    assert not meter.known
    assert "ticks every 4." in meter.fault  # not the mean with what was before
    for _ in range(1000):
        time_s += 0.004
        meter.tick(1, time_s)
    begin_s = time_s
    while meter.fault:  # at its pace again, it is one no longer
        time_s += 0.012
        meter.tick(1, time_s)
        assert time_s < begin_s + 0.5 / DRIFT
    assert meter.known


@pytest.mark.parametrize("cycle_s", [0.004, 0.012])
@pytest.mark.parametrize("seed", range(5))
def test_jitter_bursts_and_pauses_are_no_fault(cycle_s, seed):
    draw = random.Random(seed)
    step, stall_s, free_s, times = round(1000 * cycle_s), 0.0, 0.0, []
    for number in range(round(30.0 / cycle_s)):
        sent_s = number * cycle_s
        if draw.random() < 0.02:
            stall_s = sent_s + draw.random() * 0.95 * SILENCE_S
        free_s = max(free_s, stall_s, sent_s + draw.random() * 0.02)  # none overtakes another
        times.append(free_s)
    assert metered(cycle_s, step, times).fault == ""
    assert metered(cycle_s, step, times).known


def test_lost_and_jointly_read_telegrams_count_as_their_cycles():
    meter = metered(0.004, 4, every(0.012, 4.0), ticks=3)
    assert (meter.known, meter.fault) == (True, "")
    assert meter.detail == "a telegram every 4.0 ms"


def test_slow_by_ipoc_and_clock_for_a_moment_is_no_fault():
    slow = every(0.012, 0.012 * WINDOW_TICKS * (SLOW_WINDOWS - 1) + 0.1)
    assert metered(0.004, 12, slow).fault == ""
    assert not metered(0.004, 12, slow).known


def test_separate_slow_moments_are_no_fault():
    meter, time_s = CycleMeter(0.004, SILENCE_S, None), 5.0
    meter.begin(12, time_s)
    for window in range(4 * SLOW_WINDOWS):
        for _ in range(WINDOW_TICKS):
            time_s += 0.004 if window % 4 == 3 else 0.012
            meter.tick(1, time_s)
        assert meter.fault == ""
