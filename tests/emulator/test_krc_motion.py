import math
import re

import numpy as np
import pytest
from krc_bench import CYCLE_S, Bench, forward

from deltaq_cell.description import ServoLag
from deltaq_emulator.settings import OperatingMode, SettingsError
from deltaq_emulator.states import KrcState
from deltaq_protocol.rsi import EthernetConfigError

STEP = 0.0005


@pytest.mark.parametrize(
    ("correction", "hold_on", "after_loss"),
    [
        ("absolute", 1, 5 * STEP),  # bridged
        ("absolute", 0, 0.0),  # jumps back to the start
        ("relative", 1, 7 * STEP),  # the last increment twice more
        ("relative", 0, 5 * STEP),  # lost
    ],
)
def test_the_effect_of_two_lost_telegrams_depends_on_correction_and_holdon(
    correction: str, hold_on: int, after_loss: float
) -> None:
    bench = Bench(correction=correction, hold_on=hold_on)
    for k in range(1, 6):
        bench.cycle(STEP if correction == "relative" else k * STEP)
    bench.silent()
    assert bench.krc.sample.q_setpoint == pytest.approx([5 * STEP] * 6, abs=1e-8)
    bench.silent(2)
    assert bench.krc.state is KrcState.RSI_RUNNING
    assert bench.krc.sample.q_setpoint == pytest.approx([after_loss] * 6, abs=1e-7)


def test_an_omitted_element_is_held_or_reset_like_a_lost_one() -> None:
    for hold_on, expected in ((1, 0.001), (0, 0.0)):
        bench = Bench(hold_on=hold_on)
        bench.cycle(0.001)
        ipoc = bench.pc.decode(bench.krc.tick() or b"").ipoc
        bench.krc.receive(b'<Sen Type="ImFree"><AK A1="0.057296"/><IPOC>%d</IPOC></Sen>' % ipoc)
        bench.krc.tick()
        assert bench.krc.sample.q_setpoint == pytest.approx([0.001] + [expected] * 5, abs=1e-7)


def test_the_default_limit_clamps_corrections_at_five_degrees_and_five_millimetres() -> None:
    limits = {
        "correction_limit_deg": 5,
        "correction_limit_mm": 5,
        "monitor_limit_deg": 6,
        "monitor_limit_mm": 6,
    }
    bench = Bench(("e1", "a1"), **limits)
    for k in range(1, 400):
        bench.cycle([k * 2e-5, k * 5e-4])
    assert np.rad2deg(bench.krc.sample.q_setpoint[1]) == pytest.approx(5.0)
    assert bench.krc.sample.q_setpoint[0] == pytest.approx(0.005)
    assert bench.krc.sample.counters["clamped"] > 0
    assert bench.krc.state is KrcState.RSI_RUNNING


def test_exceeding_the_monitored_correction_stops_rsi_with_kss29000() -> None:
    bench = Bench(monitor_limit_deg=6)
    bench.drive([0.0, 0.0, k * 5e-4, 0.0, 0.0, 0.0] for k in range(1, 400))
    assert bench.krc.state is KrcState.STOPPED
    assert bench.krc.sample.message is not None
    assert bench.krc.sample.message.startswith("KSS29000: RSI: correction of A3 is 6.0")
    assert np.rad2deg(bench.krc.sample.q_setpoint[2]) < 6.1


@pytest.mark.parametrize(("direction", "text"), [(1.0, "the limit is 90.0"), (-1.0, "the limit is -100.0")])
def test_a_software_limit_switch_stops_the_robot_short_of_it(direction: float, text: str) -> None:
    start = np.zeros(6)
    start[1] = math.radians(89.5 if direction > 0 else -99.5)
    bench = Bench(q_start=start)
    bench.drive([0.0, direction * k * STEP, 0.0, 0.0, 0.0, 0.0] for k in range(1, 100))
    assert bench.krc.state is KrcState.STOPPED
    assert "Software limit switch A2" in str(bench.krc.message)
    assert text in str(bench.krc.message)
    bench.silent(50)
    assert -100.001 < np.rad2deg(bench.krc.sample.q_setpoint[1]) < 90.001


def test_a_step_at_standstill_ends_in_command_gear_torque(bench: Bench) -> None:
    bench.cycle()
    bench.cycle([0.0, 0.0, 0.0, math.radians(1.54), 0.0, 0.0])
    assert bench.krc.tick() is None
    assert "Command gear torque A4" in str(bench.krc.message)
    assert not bench.krc.sample.q_setpoint.any()


def test_a_lasting_acceleration_beyond_the_gear_limit_ends_in_command_gear_torque() -> None:
    for factor, stops in ((2.9, False), (3.1, True)):
        bench = Bench(cycle_s=0.004)
        bench.drive([0.0] * 5 + [0.5 * factor * 10.0 * (k * 0.004) ** 2] for k in range(15))
        assert (bench.krc.state is KrcState.STOPPED) is stops
        assert ("Command gear torque A6" in str(bench.krc.message)) is stops


def test_motion_beyond_the_axis_speed_ends_in_maximum_kinetic_energy(bench: Bench) -> None:
    speeds = [10.0 * CYCLE_S * k for k in range(200)]
    angles = np.cumsum(speeds) * CYCLE_S
    sent = bench.drive([0.0] * 5 + [angle] for angle in angles)
    assert "Maximum kinetic energy exceeded A6" in str(bench.krc.message)
    assert 1.1 * math.radians(156) < speeds[sent] < 1.2 * math.radians(156)


def test_one_lost_telegram_at_a_degree_a_cycle_stops_nothing_and_at_twice_that_it_does() -> None:
    for degrees, stops in ((0.7, False), (1.4, True)):
        bench = Bench(("a1",))
        speeds = np.minimum(np.arange(60) * 10.0 * CYCLE_S, math.radians(degrees) / CYCLE_S)
        angles = np.cumsum(speeds) * CYCLE_S
        bench.drive(angles[:50])
        assert bench.krc.state is KrcState.RSI_RUNNING
        bench.drive(angles[51:])  # the telegram between went without a reply
        assert (bench.krc.state is KrcState.STOPPED) is stops


def test_t1_allows_the_tool_a_quarter_of_a_metre_a_second() -> None:
    for mode, speed_m_s, stops in (
        (OperatingMode.T1, 0.24, False),
        (OperatingMode.T1, 0.26, True),
        (OperatingMode.AUT, 0.26, False),
    ):
        bench = Bench(("e1", "a1"), mode=mode)
        if mode is OperatingMode.T1:
            bench.krc.confirm()
        speeds = np.minimum(np.arange(100) * 0.02, speed_m_s)
        bench.drive([position, 0.0] for position in np.cumsum(speeds) * CYCLE_S)
        assert (bench.krc.state is KrcState.STOPPED) is stops
        assert ("Speed of the tool in T1" in str(bench.krc.message)) is stops


def test_after_a_fault_the_drives_bring_the_robot_to_rest_within_their_deceleration() -> None:
    bench = Bench(("a1",), late_budget=2)
    angle, speed = 0.0, 0.0
    for _ in range(40):
        speed = min(speed + 10.0 * CYCLE_S, 1.0)
        angle += speed * CYCLE_S
        bench.cycle(angle)
    bench.krc.tick()
    moving = bench.krc.sample.q_setpoint[0]
    bench.krc.stop()
    setpoints = [moving - speed * CYCLE_S, moving]
    for _ in range(30):
        bench.krc.tick()
        setpoints.append(bench.krc.sample.q_setpoint[0])
    acceleration = np.diff(setpoints, 2) / CYCLE_S**2
    assert np.abs(acceleration).max() <= 10.0 * (1 + 1e-6)
    assert setpoints[-1] == setpoints[-2]
    assert setpoints[-1] - moving == pytest.approx(1.0 / (2 * 10.0), rel=0.2)


def test_the_reported_pose_is_the_forward_kinematics_of_the_measured_joints() -> None:
    bench = Bench(servo_lag=ServoLag(dead_time_s=0.012, natural_frequency_rad_s=83.0))
    for k in range(1, 30):
        datagram = bench.krc.tick() or b""
        telegram = bench.pc.decode(datagram)
        bench.krc.receive(bench.reply(telegram.ipoc, k * STEP))
        (x, y, z) = re.findall(rb'RIst X="(.*?)" Y="(.*?)" Z="(.*?)"', datagram)[0]
        place_m = np.array([x, y, z], float) / 1000.0
        assert place_m == pytest.approx(forward(bench.krc.sample.q)[:3, 3], abs=1e-7)
        assert telegram.q == pytest.approx(bench.krc.sample.q, abs=1e-7)
    assert 0.0 < bench.krc.sample.q[0] < bench.krc.sample.q_setpoint[0] - STEP


def test_the_programmed_path_does_not_follow_corrections() -> None:
    start = np.full(6, 0.1)
    bench = Bench(q_start=start)
    for k in range(30):
        telegram = bench.cycle(k * STEP)
    assert telegram.q_programmed == pytest.approx(start, abs=1e-7)
    assert telegram.q is not None
    assert telegram.q[0] > 0.11


@pytest.mark.parametrize("krc", ["krc2", "krc4"])
def test_linear_external_axes_reach_their_targets_on_both_generations(krc: str) -> None:
    bench = Bench(("e1", "e2", "e3", "a1"), krc=krc)
    for k in range(30):
        telegram = bench.cycle([k * 1e-4, -k * 1e-4, 0.0, 0.0])
    bench.silent(2)
    assert bench.krc.sample.q[:3] == pytest.approx([29e-4, -29e-4, 0.0], abs=5e-6)
    assert telegram.q == pytest.approx([27e-4, -27e-4, 0.0, 0.0], abs=1e-4)


def test_only_the_first_telegram_of_a_kr_c2_session_has_only_its_ipoc() -> None:
    bench = Bench(krc="krc2")
    first = bench.krc.tick()
    assert first == b'<Rob Type="KUKA"><IPOC>4208163634</IPOC></Rob>'
    assert b"AIPos" in (bench.krc.tick() or b"")
    bench.krc.restart()
    telegrams = [telegram for telegram in (bench.krc.tick() for _ in range(20)) if telegram]
    assert b"AIPos" not in telegrams[0]
    assert all(b"AIPos" in telegram for telegram in telegrams[1:])
    assert b"AIPos" in (Bench(krc="krc4").krc.tick() or b"")


def test_digital_inputs_are_read_and_outputs_are_set_and_held() -> None:
    for hold_on in (1, 0):
        bench = Bench(hold_on=hold_on)
        bench.krc.set_input("closed", True)
        assert bench.cycle(gripper=True).inputs == {"closed": True}
        bench.silent()
        assert bench.krc.outputs == {"gripper": True}
        bench.silent()
        assert bench.krc.outputs == {"gripper": bool(hold_on)}


def test_text_of_the_pc_appears_on_the_pendant(bench: Bench) -> None:
    ipoc = bench.pc.decode(bench.krc.tick() or b"").ipoc
    bench.krc.receive(bench.reply(ipoc).replace(b"<EStr></EStr>", b"<EStr>held</EStr>"))
    bench.krc.tick()
    assert bench.krc.text == "held"


def test_a_robot_that_cannot_start_there_or_has_no_such_axis_is_refused() -> None:
    with pytest.raises(SettingsError, match="the robot cannot start at"):
        Bench(q_start=np.full(6, 3.0))
    with pytest.raises(EthernetConfigError, match="is no RSI axis"):
        Bench(("b1",))
