"""The probe of a session's mode: what it finds out, what it never takes for another, and how far it moves the robot."""

import re
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from remembered import remembered

from deltaq_cell.description import RobotDescription, ServoLag
from deltaq_cell.drive_lag import modelled_lag
from deltaq_cell.load import load_cell
from deltaq_emulator.drives import Servo
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.mode_probe import (
    ADRIFT,
    SESSIONS,
    KinematicMode,
    ModeProbe,
    PulsesCutShort,
    mode_of_session,
)
from deltaq_services.robot_server.probe_trial import (
    PROBE_M,
    PROBE_RAD,
    SHARE_OF_TOLERANCE,
    Mode,
    Trial,
    joint_modes,
    pulse_offsets,
)

LAB, LAB_4MS, DAWM = load_cell("lab"), load_cell("lab-4ms"), load_cell("dawm")
GR = LAB.robots["gr"]
LAG_S = LAB.gate.servo_lag_s
SIZE = np.array([PROBE_M] * 3 + [PROBE_RAD] * 6)
HALF = 31
"""Cycles of half a trial at 12 ms: a pulse of 3, lags of up to .3 s, and 3 at rest."""
TRIAL = 2 * HALF + 4
PAUSE = 2 * HALF


class Arm:
    """A KRC and its drives: a dead time, a first-order lag, noise, and four decimals.

    Attributes:
        sent: every offset that was sent.
        furthest: (n,) how far the drives got from where they stood [rad or m].
    """

    def __init__(self, mode="absolute", dead=1, share=0.7, noise=0.0, seed=0, cell=LAB, moves=True):
        robot, cycle_s = cell.robots["gr"], cell.cycle_s
        lag_cycles = round(LAG_S / cycle_s)
        self.max_dv = robot.max_acceleration * cycle_s**2
        self.mode, self.share, self.noise, self.moves = mode, share, noise, moves
        self.random = np.random.default_rng(seed)
        self.start, self.q = robot.home.copy(), robot.home.copy()
        self.probe = ModeProbe(robot, cycle_s, lag_cycles, self.measured())
        self.total, self.value = np.zeros(9), np.zeros(9)
        self.delayed = deque([np.zeros(9)] * dead, maxlen=dead + 1)
        self.ipoc = 2**32 - 100
        self.sag = np.zeros(9)
        self.sent, self.furthest = [], np.zeros(9)

    def measured(self):
        q = self.q + SIZE * self.noise * self.random.uniform(-1, 1, 9)
        scale = np.where(SIZE == PROBE_M, 1e3, np.degrees(1.0))
        return np.round(q * scale, 4) / scale

    def move(self):
        """The KRC takes the value that it has."""
        self.total = self.total + self.value if self.mode == "relative" else self.value
        self.delayed.append(self.total * self.moves)
        self.q = self.q + self.share * (self.start + self.sag + self.delayed[0] - self.q)
        self.furthest = np.maximum(self.furthest, np.abs(self.q - self.start - self.sag))
        self.ipoc = (self.ipoc + 12) % 2**32

    def cycle(self, missed_last=False, lose_reply=False):
        self.probe.cycle(self.measured(), self.ipoc, missed_last)
        sent = self.probe.added_to(np.zeros(9))
        self.sent.append(sent)
        if not lose_reply:
            self.value = sent  # of a lost one it keeps the one before: HOLDON is 1
        self.move()

    def lose_telegram(self):
        """A telegram gets lost, and so it has no reply."""
        self.move()

    def trial(self, cycles=TRIAL):
        for _ in range(cycles):
            self.cycle()
        return self.probe


@pytest.fixture
def arm() -> Arm:
    return Arm()


LAGS = st.tuples(st.integers(0, 2), st.floats(0.7, 1.0))


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(lag=LAGS, noise=st.floats(0, 0.02), seed=st.integers(0, 2**31), cell=st.sampled_from([LAB, LAB_4MS]))
def test_an_absolute_krc_is_recognised_in_one_trial_with_any_lag_and_some_noise(lag, noise, seed, cell):
    arm = Arm("absolute", *lag, noise, seed, cell)
    probe = arm.trial(0)
    while not probe.known:
        assert len(arm.sent) * cell.cycle_s < 0.8
        arm.cycle()
    assert (arm.furthest <= SIZE).all()
    assert (probe.unseen, probe.detail, probe.refused, probe.bars) == ((), "", False, False)


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(lag=LAGS, noise=st.floats(0, 0.02), seed=st.integers(0, 2**31), cell=st.sampled_from([LAB, LAB_4MS]))
def test_a_relative_krc_is_detected_within_a_pulse_and_moved_back(lag, noise, seed, cell):
    arm = Arm("relative", *lag, noise, seed, cell)
    probe = arm.trial(0)
    while probe.mode is Mode.UNKNOWN:
        assert len(arm.sent) * cell.cycle_s < 0.8
        arm.cycle()
    assert probe.mode is Mode.RELATIVE
    assert probe.refused
    assert probe.bars
    assert "adds corrections up" in probe.detail
    assert "RSI_ON(#ABSOLUTE)" in probe.detail
    assert (arm.furthest <= SIZE * 1.001).all()
    arm.trial(30)
    np.testing.assert_allclose(arm.q, arm.start, atol=1e-12)
    assert not np.any(arm.sent[-30:])


@pytest.mark.nightly
@settings(deadline=None, max_examples=200)
@given(
    mode=st.sampled_from(["absolute", "relative"]),
    moves=st.booleans(),
    lag=LAGS,
    noise=st.floats(0, 0.2),
    seed=st.integers(0, 2**31),
    losses=st.lists(st.sampled_from([""] * 6 + ["telegram", "reply", "twice"]), min_size=60, max_size=160),
)
def test_losses_never_confuse_the_modes_or_move_a_joint_far(mode, moves, lag, noise, seed, losses):
    arm = Arm(mode, *lag, noise, seed, moves=moves)
    missed = False
    for loss in losses:
        if loss == "telegram":
            arm.lose_telegram()
            missed = True
        arm.cycle(missed, lose_reply=loss == "reply")
        missed = loss == "reply"
    truth = {"absolute": Mode.ABSOLUTE, "relative": Mode.RELATIVE}[mode] if moves else Mode.UNKNOWN
    assert arm.probe.mode in ({truth, Mode.UNKNOWN} | ({Mode.ADRIFT} if mode == "relative" else set()))
    if mode == "absolute":
        assert (arm.furthest <= SIZE).all()
    else:
        assert (arm.furthest <= (ADRIFT + 2) * SIZE).all()


@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
def test_a_trial_has_a_zero_sum_and_keeps_acceleration_limits(cell):
    arm = Arm(cell=cell)
    arm.trial(180)
    sent = np.array(arm.sent)
    np.testing.assert_allclose(sent.sum(axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.abs(sent).sum(axis=0), 2 * SIZE)
    assert (np.abs(np.diff(sent, n=2, axis=0)) <= arm.max_dv * (1 + 1e-9)).all()


@pytest.mark.parametrize("cycle_s", [0.1, 0.03, 0.012, 0.004, 0.001])
def test_a_pulse_is_as_short_as_limits_of_acceleration_allow(cycle_s):
    pulse, max_dv = pulse_offsets(GR, cycle_s), GR.max_acceleration * cycle_s**2
    half = (len(pulse) + 1) // 2
    assert len(pulse) == 2 * half - 1
    assert (2 * SIZE / half**2 <= max_dv).all()
    assert half == 1 or (2 * SIZE / (half - 1) ** 2 > max_dv).any()


@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
def test_a_trial_adds_a_pulse_and_its_negative(cell):
    pulse = pulse_offsets(cell.robots["gr"], cell.cycle_s)
    arm = Arm(cell=cell)
    arm.trial(180)
    moved = [offset for offset in arm.sent if offset.any()]
    np.testing.assert_array_equal(moved, [*pulse, *-pulse])


def test_a_robot_without_response_is_probed_until_it_moves():
    arm = Arm(moves=False)
    probe = arm.trial(TRIAL - 1)
    assert (probe.unseen, probe.bars, probe.detail) == ((), False, "probes the mode of corrections")
    arm.cycle()
    assert probe.unseen == GR.joint_names
    assert probe.detail.startswith("e1, e2, e3, a1, a2, a3, a4, a5, a6 did not follow the mode probe")
    assert (probe.mode, probe.known, probe.refused, probe.bars) == (Mode.UNKNOWN, False, False, True)
    for _ in range(PAUSE):
        assert probe.idle
        arm.cycle()
        assert not arm.sent[-1].any()
    arm.moves = True
    assert arm.trial().known
    assert not probe.bars


def test_a_joint_that_does_not_follow_is_named_and_blocks_the_robot(arm):
    arm.moves = np.array([1.0] * 8 + [0.0])
    probe = arm.trial()
    assert probe.unseen == ("a6",)
    assert probe.bars


@pytest.mark.parametrize("factor", [-1.0, 0.3, 4.0, 57.3])
def test_a_joint_with_another_direction_or_amount_of_motion_is_not_absolute(arm, factor):
    arm.moves = np.array([1.0] * 8 + [factor])
    assert not arm.trial(3 * TRIAL).known


def test_one_relative_joint_is_enough_to_refuse(arm):
    relative = Arm("relative")
    for _ in range(TRIAL):
        arm.cycle()
        relative.cycle()
        arm.q[4] = relative.q[4]
    assert arm.probe.mode is Mode.RELATIVE


@pytest.mark.parametrize("cycle", [5, 10, HALF + 5])
@pytest.mark.parametrize("sag", [0.8, -0.8])
def test_a_sagging_robot_has_an_unknown_mode_and_is_probed_again(arm, cycle, sag):
    arm.trial(cycle)
    arm.sag = sag * SIZE
    probe = arm.trial(TRIAL - cycle)
    assert probe.mode is Mode.UNKNOWN
    arm.trial(PAUSE)
    assert arm.trial().known


def test_a_robot_moving_without_corrections_for_several_telegrams_is_adrift(arm):
    for cycles in (1, 2):
        arm.trial(1)
        arm.sag = 1.1 * ADRIFT * SIZE
        arm.q = arm.start + arm.sag
        arm.trial(cycles)
        assert arm.probe.mode is Mode.UNKNOWN
        arm.sag = np.zeros(9)
        arm.q = arm.start.copy()
    arm.trial(1)
    arm.sag = 1.1 * ADRIFT * SIZE
    arm.q = arm.start + arm.sag
    arm.trial(3)
    assert arm.probe.mode is Mode.ADRIFT
    assert (arm.probe.refused, arm.probe.bars, arm.probe.idle) == (True, True, True)
    assert arm.probe.detail.startswith("the robot moves although its correction is constant")


def test_a_pulse_is_aborted_when_the_robot_is_adrift(arm):
    arm.trial(2)
    arm.sag = 1.1 * ADRIFT * SIZE
    arm.q = arm.start + arm.sag
    arm.trial(2)
    assert arm.sent[-1].any()
    assert arm.trial(1).mode is Mode.ADRIFT
    assert not arm.sent[-1].any()


def test_a_robot_displaced_from_the_first_telegram_on_is_adrift_after_three(arm):
    arm.sag = 1.1 * ADRIFT * SIZE
    arm.q = arm.start + arm.sag
    assert arm.trial(2).mode is Mode.UNKNOWN
    assert arm.trial(1).mode is Mode.ADRIFT


@pytest.mark.parametrize("at", [*range(10), 20, *range(HALF, HALF + 9), TRIAL - 1])
def test_on_a_signal_a_pulse_is_undone_and_none_begun(at):
    arm = Arm("relative")
    probe = arm.trial(at)
    probe.end()
    while not probe.idle:
        arm.cycle()
        assert len(arm.sent) <= TRIAL
    begun = np.any(arm.sent)
    arm.trial(100)
    assert np.any(arm.sent) == begun == (at > 3)
    np.testing.assert_allclose(np.sum(arm.sent, axis=0), 0.0, atol=1e-15)
    np.testing.assert_allclose(arm.q, arm.start, atol=1e-12)


@pytest.mark.parametrize(
    "at", [4, 5, 7, HALF + 4, HALF + 7]
)  # in reply to samples 3 to 5 there is a pulse, and half a trial later
@pytest.mark.parametrize("lost", ["reply", "telegram"])
def test_a_trial_with_a_loss_near_a_pulse_has_no_result_and_is_repeated(lost, at):
    arm = Arm(moves=False)
    arm.trial(at)
    if lost == "telegram":
        arm.lose_telegram()
        arm.cycle()
    else:
        arm.cycle(missed_last=True)
    arm.trial(TRIAL - at - 1)
    assert arm.probe.unseen == ()
    arm.moves = True
    assert arm.trial().known


@pytest.mark.parametrize("at", [1, 8, HALF + 3, TRIAL - 1])
def test_a_loss_far_from_a_pulse_costs_no_trial(arm, at):
    arm.trial(at)
    arm.cycle(missed_last=True)
    assert arm.trial(TRIAL - at - 1).known


def test_no_joint_is_displaced_by_more_than_a_share_of_its_tracking_tolerance():
    fields = GR.model_dump(exclude_unset=True)
    fields["joints"]["a1"]["tracking_tolerance_deg"] = 0.01
    robot = RobotDescription.model_validate(fields)
    probe = ModeProbe(robot, 0.012, 6, robot.home)
    total = np.zeros(9)
    for count in range(14):
        probe.cycle(robot.home, 12 * count, False)
        total += probe.added_to(np.zeros(9))
    assert np.degrees(total[3]) == pytest.approx(0.01 * SHARE_OF_TOLERANCE)
    assert np.degrees(total[4]) == pytest.approx(0.03)
    assert (total <= SHARE_OF_TOLERANCE * robot.tracking_tolerance).all()


class Drives(Arm):
    """The same with drives of a dead time and a second-order lag, some of them slower than the others."""

    def __init__(self, lag, later_s=0.0, decimals=4, cell=LAB, jitter=0.0):
        self.servos, self.decimals, self.jitter = [], decimals, jitter
        super().__init__(cell=cell)
        late = lag.model_copy(update={"dead_time_s": lag.dead_time_s + later_s})
        self.servos = [Servo(self.start, each, cell.cycle_s) for each in (lag, late)]

    def measured(self):
        q = np.concatenate([self.servos[0].q[:3], self.servos[1].q[3:]]) if self.servos else self.start
        scale = np.where(SIZE == PROBE_M, 1e3, np.degrees(1.0))
        noise = self.jitter * 10.0**-self.decimals * self.random.uniform(-1, 1, 9)
        return np.round(q * scale + noise, self.decimals) / scale

    def move(self):
        for servo in self.servos:
            servo.advance(self.start + self.value)
        self.ipoc = (self.ipoc + 12) % 2**32


SLOW = ServoLag(dead_time_s=0.058, natural_frequency_rad_s=40.0)
"""Of a response of 50 ms, and 120 ms in all: 189 ms until all but a twentieth has arrived."""


@pytest.mark.parametrize("cell", [LAB, LAB_4MS])
@pytest.mark.parametrize("later_s", [0.0, 0.036])
@pytest.mark.parametrize(
    "lag",
    [
        ServoLag(),
        SLOW,
        ServoLag(dead_time_s=0.07, natural_frequency_rad_s=60.0, damping=0.7),
        ServoLag(dead_time_s=0.05, natural_frequency_rad_s=50.0, damping=0.5),
    ],
)
def test_the_lag_of_each_axis_is_measured_to_a_cycle_of_12_ms(cell, later_s, lag):
    arm = Drives(lag, later_s, cell=cell)
    lags = arm.trial(arm.probe.trial_cycles).lags
    for joint, measured in enumerate(lags):
        dead_s = lag.dead_time_s + later_s * (joint >= 3)
        true = modelled_lag(lag.model_copy(update={"dead_time_s": dead_s}), cell.cycle_s)
        for name, within_s in (("dead_s", 0.012), ("half_s", 0.003), ("mean_s", 0.004), ("settled_s", 0.012)):
            assert getattr(measured, name) == pytest.approx(getattr(true, name), abs=within_s)
        assert measured.overshoot == pytest.approx(true.overshoot, abs=0.02)
        assert measured.least_s <= measured.settled_s


def test_drives_that_lag_more_than_the_gate_presumes_are_refused_with_axis_and_figures():
    arm = Drives(ServoLag(dead_time_s=0.144, natural_frequency_rad_s=200.0), later_s=0.048)
    probe = arm.trial()
    assert (probe.mode, probe.known, probe.refused, probe.bars) == (Mode.ABSOLUTE, False, True, True)
    assert probe.reason is ReasonCode.DRIVE_LAG
    said = r"axis a\d lags 234 ms, the gate presumes 204: set gate.servo_lag_s to at least 0\.252"
    assert re.fullmatch(said, probe.detail)
    assert not np.any(probe.added_to(np.zeros(9)))


def test_drives_that_do_not_settle_within_a_window_are_not_driven():
    probe = Drives(ServoLag(dead_time_s=0.07, natural_frequency_rad_s=20.0, damping=0.5)).trial()
    assert (probe.mode, probe.unseen) == (Mode.UNKNOWN, GR.joint_names)
    assert probe.detail.endswith("do the drives lag less than 300 ms?")


@pytest.mark.parametrize(("decimals", "jitter"), [(3, 0.0), (4, 8.0)])
def test_a_lag_hidden_by_decimals_or_noise_is_unknown_and_holds_no_robot(decimals, jitter):
    slow = SLOW.model_copy(update={"dead_time_s": 0.1})  # 231 ms, where the gate presumes 204
    probe = Drives(slow, decimals=decimals, jitter=jitter).trial(2 * TRIAL + PAUSE)
    assert set(probe.lags) == {None}
    assert probe.known


def test_a_telegram_lost_within_a_response_hardly_changes_the_measured_lag():
    whole, gap = Drives(SLOW), Drives(SLOW)
    whole.trial()
    for cycle in range(TRIAL):
        if cycle in (12, HALF + 15):
            gap.lose_telegram()
        gap.cycle()
    for one, other in zip(whole.probe.lags, gap.probe.lags, strict=True):
        assert one.settled_s == pytest.approx(other.settled_s, abs=0.006)


WINDOW = 12
SHAPE = Trial(rest=3, pulse=3, window=WINDOW)
FIRST, SECOND = 4, 4 + WINDOW
"""Samples in which the first pulse can be seen at the earliest, and its negative."""


def course(*pulses, adds_up=False, drift=0.0):
    """Samples of a joint that some shares of a pulse displace at some samples, and that drifts by so much a window."""
    samples = np.arange(FIRST + 2 * WINDOW) * drift / WINDOW
    for at, share in pulses:
        samples[at : None if adds_up else at + 1] += share
    return samples[:, np.newaxis]


@pytest.mark.parametrize("late", [0, WINDOW - 4])
def test_a_response_is_seen_as_early_and_as_late_as_a_window_allows(late):
    pulses = (FIRST + late, 1.0), (SECOND + late, -1.0)
    assert joint_modes(course(*pulses), SHAPE, WINDOW) == [Mode.ABSOLUTE]
    assert joint_modes(course(*pulses, adds_up=True), SHAPE, WINDOW) == [Mode.RELATIVE]


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_only_responses_between_half_and_twice_a_pulse_count(share):
    within = 0.51 if share < 1 else 1.99
    for amount, mode in ((share, Mode.UNKNOWN), (within, Mode.ABSOLUTE)):
        assert joint_modes(course((FIRST, amount), (SECOND, -amount)), SHAPE, WINDOW) == [mode]
    assert joint_modes(course((FIRST, 0.5), (SECOND, -0.5), adds_up=True), SHAPE, WINDOW) == [Mode.UNKNOWN]
    assert joint_modes(course((FIRST, 0.51), (SECOND, -0.51), adds_up=True), SHAPE, WINDOW) == [Mode.RELATIVE]


@pytest.mark.parametrize("within", [FIRST, SECOND])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_joint_a_quarter_of_a_pulse_away_has_not_returned(within, sign):
    for away, mode in ((0.25, Mode.UNKNOWN), (0.24, Mode.ABSOLUTE)):
        samples = course((FIRST, 1.0), (SECOND, -1.0))
        samples[within + WINDOW // 2 :] += sign * away  # from the middle of a window, so that it has no area
        assert joint_modes(samples, SHAPE, WINDOW) == [mode]


@pytest.mark.parametrize("early", [FIRST - 1, SECOND - 1])
def test_motion_before_a_pulse_can_arrive_is_no_response(early):
    assert joint_modes(course((early, 1.0)), SHAPE, WINDOW) == [Mode.UNKNOWN]


@pytest.mark.parametrize("drift", [0.2, -0.2])
def test_a_slow_drift_neither_counts_as_a_response_nor_hides_one(drift):
    assert joint_modes(course((FIRST, 1.0), (SECOND, -1.0), drift=drift), SHAPE, WINDOW) == [Mode.ABSOLUTE]
    assert joint_modes(course(drift=drift), SHAPE, WINDOW) == [Mode.UNKNOWN]


def test_a_kinematic_robot_needs_no_mode_probe():
    dawm = DAWM.robots["dawm"]
    mode = mode_of_session(dawm, 0.012, 1, dawm.home)
    assert isinstance(mode, KinematicMode)
    mode.cycle(dawm.home + 1.0, 0, True)
    mode.end()
    assert mode.added_to(dawm.home) is dawm.home
    assert (mode.known, mode.refused, mode.bars, mode.idle, mode.detail) == (True, False, False, True, "")
    assert isinstance(mode_of_session(GR, 0.012, 6, GR.home), ModeProbe)


# Setpoints with the pulse of a probe and without it, by the sessions in which they were sent.


def place(value):
    return np.full(2, float(value))


def cut(pulses, value, pulse=0.5):
    pulses.sent(place(value) + pulse, place(value))
    pulses.cut_short()
    return pulses


def test_corrections_of_a_continuing_session_are_not_searched_for():
    pulses = PulsesCutShort()
    pulses.sent(place(1.5), place(1))
    np.testing.assert_array_equal(pulses.undone(place(1.5)), place(1.5))
    pulses.cut_short()
    np.testing.assert_array_equal(pulses.undone(place(1.5)), place(1))
    pulses.cut_short()  # a session in which nothing was sent
    np.testing.assert_array_equal(pulses.undone(place(1.5)), place(1))


def test_every_joint_must_be_at_its_setpoint_within_rounding():
    pulses = cut(PulsesCutShort(), 0)
    np.testing.assert_array_equal(pulses.undone(place(0.5) + 1e-12), place(0))
    for off in ([1e-6, 0.0], [0.0, -1e-6]):
        np.testing.assert_array_equal(pulses.undone(place(0.5) + off), place(0.5) + off)
    exactly = cut(PulsesCutShort(), 0.0, pulse=0.0)
    np.testing.assert_array_equal(exactly.undone(place(1e-9)), place(0))


def test_of_two_sessions_at_one_place_the_later_counts():
    pulses = cut(cut(PulsesCutShort(), 0, pulse=1.0), 0.25, pulse=0.75)
    np.testing.assert_array_equal(pulses.undone(place(1)), place(0.25))


def test_a_bounded_number_of_sessions_is_remembered_and_restored():
    pulses = PulsesCutShort()
    for number in range(SESSIONS + 1):
        cut(pulses, number)
    pulses.sent(place(1000.5), place(1000))
    heir = PulsesCutShort()
    heir.restore(pulses.snapshot())
    assert remembered(heir) == remembered(pulses)
    heir.cut_short()
    np.testing.assert_array_equal(heir.undone(place(1000.5)), place(1000))
    for lost in (0, 1):
        np.testing.assert_array_equal(heir.undone(place(lost + 0.5)), place(lost + 0.5))
    np.testing.assert_array_equal(heir.undone(place(2.5)), place(2))
