"""RSI_ON, RSI_MOVECORR and what ends it."""

import numpy as np
import pytest
from krc_bench import CYCLE_S, Bench

from deltaq_cell.description import ServoLag
from deltaq_emulator.settings import OperatingMode
from deltaq_emulator.states import TELEGRAMS_GO_OUT, TRANSITIONS, KrcEvent, KrcState, NotNowError
from deltaq_protocol.rsi import EthernetConfigError

STEP = 0.0005


def moving(bench: Bench, cycles: int = 60) -> tuple[float, float]:
    """Bring every joint to 1 rad/s; returns the correction and its step per cycle."""
    angle, speed = 0.0, 0.0
    for _ in range(cycles):
        speed = min(speed + 5.0 * CYCLE_S, 1.0)
        angle += speed * CYCLE_S
        bench.cycle(angle)
    return angle, speed * CYCLE_S


def until_it_ends(bench: Bench, stop: bool) -> list[np.ndarray]:
    """Answer until RSI is off; returns the setpoints on the way."""
    setpoints = []
    while (datagram := bench.krc.tick()) is not None:
        setpoints.append(bench.krc.sample.q_setpoint)
        reply = bench.reply(bench.pc.decode(datagram).ipoc, 3.0)
        bench.krc.receive(reply.replace(b"<Stop>0", b"<Stop>%d" % stop))
        assert len(setpoints) < 1000
    return setpoints


@pytest.mark.parametrize("state", sorted(TELEGRAMS_GO_OUT))
@pytest.mark.parametrize("event", [KrcEvent.STOP, KrcEvent.FAULT, KrcEvent.DRIVES_OFF, KrcEvent.CHANGE_MODE])
def test_a_program_can_be_ended_in_every_state(state: KrcState, event: KrcEvent) -> None:
    assert TRANSITIONS[state, event] not in TELEGRAMS_GO_OUT


def test_stop_ends_the_motion_along_the_ramps_of_the_drives_and_then_the_program() -> None:
    bench = Bench(("a1",), servo_lag=ServoLag())
    angle, step = moving(bench)
    bench.cycle(angle + step, stop=True)
    setpoints = until_it_ends(bench, stop=True)
    assert bench.krc.state is KrcState.READY
    assert str(bench.krc.message) == "RSI_MOVECORR was ended by the signal Stop"
    steps = np.diff([angle, *(setpoint[0] for setpoint in setpoints)])
    assert np.abs(np.diff([step, *steps])).max() <= 10.0 * CYCLE_S**2 * (1 + 1e-4)  # the limit of the joint
    assert steps[-1] == 0.0
    assert setpoints[-1][0] - angle == pytest.approx(1.0 / (2 * 10.0), rel=0.2)
    assert bench.krc.sample.q == pytest.approx(setpoints[-1], abs=1e-5)


def test_telegrams_are_exchanged_and_corrections_ignored_until_the_ended_motion_is_over() -> None:
    bench = Bench(("a1",), servo_lag=ServoLag())
    angle, _ = moving(bench)
    bench.cycle(angle, stop=True)
    assert bench.krc.tick() is not None
    assert bench.krc.state is KrcState.MOTION_ENDED
    accepted = bench.krc.sample.counters["accepted"]
    setpoints = until_it_ends(bench, stop=False)
    assert bench.krc.sample.counters["accepted"] >= accepted + len(setpoints) - 1
    assert bench.krc.sample.message is not None


def test_stop_ends_the_motion_on_its_rising_edge_only(bench: Bench) -> None:
    bench.cycle(stop=True)
    bench.krc.tick()
    assert bench.krc.state is KrcState.READY  # it stood still, and the program came to its end at once
    bench.krc.restart()
    until_telegram = 0
    while bench.krc.tick() is None:
        until_telegram += 1
        assert until_telegram < 100
    bench.cycle(stop=False)
    bench.cycle(STEP, stop=False)
    bench.krc.tick()
    assert bench.krc.state is KrcState.RSI_RUNNING


@pytest.mark.parametrize(("hold_on", "ends"), [(1, False), (0, True)])
def test_a_set_stop_rises_again_only_if_a_lost_telegram_resets_it(hold_on: int, ends: bool) -> None:
    bench = Bench(hold_on=hold_on, mode=OperatingMode.T1)
    bench.cycle(stop=True)  # before RSI_MOVECORR: nothing to end
    bench.krc.tick()
    bench.krc.confirm()
    bench.silent()
    bench.cycle(stop=True)
    bench.krc.tick()
    assert (bench.krc.state is KrcState.READY) is ends


def test_a_reply_without_the_element_keeps_the_stop_signal(bench: Bench) -> None:
    bench.cycle(STEP)
    ipoc = bench.pc.decode(bench.krc.tick() or b"").ipoc
    bench.krc.receive(b'<Sen Type="ImFree"><AK A1="0"/><IPOC>%d</IPOC></Sen>' % ipoc)
    bench.krc.tick()
    assert bench.krc.state is KrcState.RSI_RUNNING


def test_without_a_stop_in_the_cell_the_signal_is_an_ordinary_output() -> None:
    bench = Bench(driver={"stop": None})
    bench.cycle(STEP, stop=True)
    bench.krc.tick()
    assert bench.krc.state is KrcState.RSI_RUNNING


@pytest.mark.parametrize(
    ("tag", "message"),
    [
        ("Halt", "no BOOL signal Halt, which the cell names for driver.stop"),
        ("AK.A1", "no BOOL signal AK.A1"),
    ],
)
def test_an_impossible_stop_signal_is_refused(tag: str, message: str) -> None:
    with pytest.raises(EthernetConfigError, match=message):
        Bench(driver={"stop": tag})


def test_in_t1_nothing_moves_before_the_warning_is_confirmed() -> None:
    bench = Bench(mode=OperatingMode.T1)
    for _ in range(5):
        bench.cycle(0.001, gripper=True)
    bench.krc.tick()
    assert bench.krc.state is KrcState.RSI_ON
    assert str(bench.krc.message) == "Sensor corrections will move the robot: confirm"
    assert not bench.krc.sample.q_setpoint.any()
    assert bench.krc.outputs == {"gripper": True}  # the signals pass from RSI_ON on
    assert bench.krc.sample.counters["accepted"] == 5
    bench.krc.confirm()
    assert bench.krc.message is None
    bench.cycle(0.001)
    bench.krc.tick()
    assert bench.krc.state is KrcState.RSI_RUNNING
    assert bench.krc.sample.q_setpoint == pytest.approx([0.001] * 6, abs=1e-8)


def test_late_replies_count_from_the_command_rsi_on() -> None:
    bench = Bench(mode=OperatingMode.T1, late_budget=3)
    bench.cycle()
    bench.silent(5)
    assert bench.krc.state is KrcState.STOPPED


def test_there_is_nothing_to_confirm_outside_t1() -> None:
    bench = Bench(mode=OperatingMode.AUT)
    assert bench.krc.state is KrcState.RSI_RUNNING
    with pytest.raises(NotNowError, match="'confirm' is not possible while RSI running"):
        bench.krc.confirm()


def test_a_key_turned_to_t1_asks_for_the_confirmation_at_the_next_start(bench: Bench) -> None:
    bench.cycle()
    bench.krc.set_mode(OperatingMode.T1)
    bench.krc.restart()
    while bench.krc.tick() is None:
        pass
    assert bench.krc.state is KrcState.RSI_ON


def test_a_constant_relative_correction_is_a_constant_velocity() -> None:
    bench = Bench(("a1", "e1"), correction="relative")
    for k in range(1, 20):
        bench.cycle([STEP, STEP / 10])
        bench.krc.tick()
        bench.krc.receive(bench.reply(bench.krc.sample.ipoc, [STEP, STEP / 10]))
        assert bench.krc.sample.q_setpoint == pytest.approx(
            [(2 * k - 1) * STEP, (2 * k - 1) * STEP / 10], abs=1e-7
        )


def test_increments_before_rsi_movecorr_are_not_summed_up() -> None:
    bench = Bench(correction="relative", mode=OperatingMode.T1)
    for _ in range(10):
        bench.cycle(STEP)
    bench.krc.confirm()
    bench.krc.tick()
    assert bench.krc.sample.q_setpoint == pytest.approx([STEP] * 6, abs=1e-7)


def test_relative_corrections_are_cut_off_at_the_limit_of_their_sum() -> None:
    bench = Bench(("a1",), correction="relative", correction_limit_deg=1)
    for _ in range(100):
        bench.cycle(STEP)
    assert np.rad2deg(bench.krc.sample.q_setpoint) == pytest.approx([1.0])
    bench.cycle(-STEP)
    bench.krc.tick()
    assert np.rad2deg(bench.krc.sample.q_setpoint) == pytest.approx([1.0 - np.rad2deg(STEP)], abs=1e-6)


def test_the_operator_selects_the_program_and_the_selection_persists(bench: Bench) -> None:
    for chosen, setpoint in ((None, STEP), ("relative", 3 * STEP), (None, 3 * STEP), ("absolute", STEP)):
        bench.krc.restart(chosen)
        while bench.krc.tick() is None:
            pass
        start = bench.krc.sample.q_setpoint
        bench.krc.receive(bench.reply(bench.krc.sample.ipoc, STEP))
        bench.cycle(STEP)
        bench.cycle(STEP)
        bench.krc.tick()
        assert bench.krc.sample.q_setpoint - start == pytest.approx([setpoint] * 6, abs=1e-7)
