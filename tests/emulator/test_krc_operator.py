import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from krc_bench import Bench

from deltaq_cell.description import ServoLag
from deltaq_emulator.catalogue import TEXTS, Code, KrcMessage
from deltaq_emulator.faults import FaultyLink
from deltaq_emulator.krc import START_CYCLES
from deltaq_emulator.panel import MAX_AWAITED, Panel
from deltaq_emulator.recorder import CsvRecorder
from deltaq_emulator.settings import KrcSettings, OperatingMode, SettingsError, profile_for
from deltaq_emulator.states import TRANSITIONS, KrcEvent, KrcState, NotNowError, after


def make_panel(bench: Bench) -> Panel:
    return Panel("fr", bench.krc, FaultyLink(1), FaultyLink(2), CsvRecorder(0.012, bench.n))


def answers(panel: Panel, request_bytes: bytes) -> list[dict[str, Any]]:
    """The answers to a request, those that come later too."""
    told: list[dict[str, Any]] = []
    panel.take(request_bytes, lambda answer: told.append(json.loads(answer)))
    return told


def later(panel: Panel, **request: Any) -> list[dict[str, Any]]:
    return answers(panel, json.dumps({"op": "await"} | request).encode())


def ask(panel: Panel, **request: Any) -> dict[str, Any]:
    (answer,) = answers(panel, json.dumps(request).encode())
    return answer


def test_the_state_table_uses_every_event_and_reaches_every_state() -> None:
    assert {event for _, event in TRANSITIONS} == set(KrcEvent)
    assert {state for state, _ in TRANSITIONS} == set(KrcState) == set(TRANSITIONS.values())


@pytest.mark.parametrize("state", KrcState)
@pytest.mark.parametrize("event", KrcEvent)
def test_an_unexpected_event_is_refused_with_the_permitted_ones(state: KrcState, event: KrcEvent) -> None:
    if (state, event) in TRANSITIONS:
        assert after(state, event) is TRANSITIONS[state, event]
    else:
        with pytest.raises(NotNowError, match=rf"'{event}' is not possible while {state}; possible are: "):
            after(state, event)


@pytest.mark.parametrize("code", Code)
def test_every_message_has_a_text(code: Code) -> None:
    assert TEXTS[code]
    assert "{" not in str(KrcMessage(code, "A1", 1.0, 2.0, "deg"))


def test_a_stopped_controller_restarts_only_after_its_message_was_acknowledged() -> None:
    bench = Bench(late_budget=1)
    bench.cycle()
    bench.silent(5)
    assert bench.krc.state is KrcState.STOPPED
    with pytest.raises(NotNowError, match="possible are: acknowledge"):
        bench.krc.restart()
    bench.krc.acknowledge()
    assert bench.krc.state is KrcState.READY
    assert bench.krc.message is None
    bench.krc.restart()
    assert bench.silent(START_CYCLES - 1) is None
    assert bench.silent() is not None
    assert bench.krc.state is KrcState.RSI_RUNNING


def test_a_new_session_starts_where_the_robot_rests_with_no_correction_and_no_delay() -> None:
    bench = Bench(servo_lag=ServoLag())
    for k in range(1, 40):
        bench.cycle(k * 0.0005)
    bench.silent(3)
    last_ipoc = bench.krc.sample.ipoc
    bench.krc.restart()
    telegram = None
    while telegram is None:
        telegram = bench.krc.tick()
    decoded = bench.pc.decode(telegram)
    assert decoded.delay == 0
    assert decoded.ipoc > last_ipoc + 12
    assert decoded.q_programmed is not None
    assert decoded.q_programmed[0] > 0.015
    assert decoded.q == pytest.approx(decoded.q_programmed, abs=2e-5)
    resting = bench.krc.sample.q_setpoint.copy()
    bench.krc.receive(bench.reply(decoded.ipoc, 0.0))
    bench.krc.tick()
    assert bench.krc.sample.q_setpoint == pytest.approx(resting)


@pytest.mark.parametrize("correction", ["absolute", "relative"])
def test_a_new_session_holds_no_correction_of_the_last_one(correction: str) -> None:
    bench = Bench(correction=correction)
    bench.cycle(0.001)
    bench.krc.tick()
    bench.krc.stop()
    assert bench.krc.message is not None
    bench.krc.restart()
    while bench.krc.tick() is None:
        pass
    resting = bench.krc.sample.q_setpoint.copy()
    assert resting.any()
    assert bench.krc.message is None
    bench.silent(3)
    assert bench.krc.sample.q_setpoint == pytest.approx(resting, abs=1e-12)
    assert bench.krc.state is KrcState.RSI_RUNNING


def test_restarting_a_running_program_waits_until_the_robot_rests() -> None:
    bench = Bench(("a1",), servo_lag=ServoLag())
    angle, speed = 0.0, 0.0
    for _ in range(60):
        speed = min(speed + 0.1, 1.5)
        angle += speed * 0.012
        bench.cycle(angle)
    bench.krc.restart()
    while bench.krc.tick() is None:
        pass
    before = bench.krc.sample.q
    bench.krc.tick()
    assert bench.krc.sample.q == pytest.approx(before, abs=2e-5)


def test_turning_the_key_stops_the_program_with_a_message(bench: Bench) -> None:
    bench.cycle()
    bench.krc.set_mode(OperatingMode.T1)
    assert bench.krc.mode is OperatingMode.T1
    assert bench.krc.state is KrcState.READY
    assert str(bench.krc.message) == "Operating mode changed to T1"
    assert bench.krc.tick() is None


def test_a_program_does_not_start_without_drives(bench: Bench) -> None:
    bench.krc.set_drives(False)
    assert bench.krc.state is KrcState.DRIVES_OFF
    assert bench.krc.tick() is None
    with pytest.raises(NotNowError):
        bench.krc.restart()
    bench.krc.set_drives(True)
    bench.krc.restart()
    assert bench.silent(START_CYCLES) is not None


def test_a_frozen_controller_is_silent_while_its_time_advances(bench: Bench) -> None:
    before = bench.cycle(0.001).ipoc
    bench.krc.freeze(5)
    assert [bench.krc.tick() for _ in range(5)] == [None] * 5
    assert bench.krc.state is KrcState.RSI_RUNNING
    assert bench.cycle(0.001).ipoc == before + 6 * 12


@pytest.mark.parametrize("shift_ms", [-24, 1200])
def test_an_injected_jump_changes_the_time_stamp(bench: Bench, shift_ms: int) -> None:
    before = bench.cycle().ipoc
    bench.krc.shift_ipoc(shift_ms)
    assert bench.cycle().ipoc == before + 12 + shift_ms
    bench.cycle()
    assert bench.krc.sample.counters["accepted"] == 2


def test_the_panel_shows_every_state_and_obeys_the_operator() -> None:
    bench = Bench(late_budget=1)
    panel = make_panel(bench)
    bench.cycle(0.001)
    bench.krc.tick()
    status = ask(panel, op="status")
    assert status["ok"] is True
    assert (status["state"], status["mode"], status["message"]) == ("RSI running", "AUT", None)
    assert status["q_setpoint"] == pytest.approx([0.001] * 6, abs=1e-8)
    assert status["counters"]["accepted"] == 1
    assert ask(panel, op="input", name="closed", value=True)["inputs"] == {"closed": True}
    assert ask(panel, op="stop")["message"] == "Program stopped by the operator"
    assert ask(panel, op="mode", mode="T2")["mode"] == "T2"
    assert ask(panel, op="drives", on=False)["state"] == "drives off"
    assert ask(panel, op="drives", on=True)["state"] == "ready"
    assert ask(panel, op="restart")["ok"] is True
    assert bench.silent(START_CYCLES) is not None


def test_the_panel_sets_and_clears_faults(bench: Bench) -> None:
    panel = make_panel(bench)
    faults = ask(panel, op="fault", link="from_pc", drop=0.5, delay_s=0.002)["faults"]
    assert (faults["from_pc"]["drop"], faults["from_pc"]["delay_s"]) == (0.5, 0.002)
    assert faults["to_pc"]["drop"] == 0.0
    assert ask(panel, op="fault", freeze_cycles=3)["faults"]["from_pc"]["drop"] == 0.5
    assert bench.silent(3) is None
    assert bench.silent() is not None
    before = bench.krc.sample.ipoc
    assert ask(panel, op="fault", ipoc_shift_ms=-120)["ok"]
    bench.silent()
    assert bench.krc.sample.ipoc == before + 12 - 120
    assert ask(panel, op="fault")["faults"]["from_pc"]["drop"] == 0.0


def test_the_panel_forges_telegrams_until_a_stop_request() -> None:
    bench = Bench(precision=4)
    panel = make_panel(bench)
    forge = [{"address": "127.0.0.9", "ipoc_shift": 7000}, {"offset_deg": 1.4}]
    assert [each["ipoc_shift"] for each in ask(panel, op="fault", forge=forge)["forged"]] == [7000, 0]
    truth = bench.cycle(0.001)
    far, near = (bench.pc.decode(bench.krc.forged(forgery)) for forgery in panel.forgeries)
    assert (far.ipoc, near.ipoc) == (truth.ipoc + 7000, truth.ipoc)
    assert far.q == pytest.approx(truth.q)
    assert np.rad2deg(near.q - truth.q) == pytest.approx([1.4] * 6, abs=1e-3)
    assert near.q_programmed == pytest.approx(truth.q_programmed)
    assert ask(panel, op="fault", freeze_cycles=1)["forged"] != []
    assert ask(panel, op="fault")["forged"] == []


def test_a_forged_telegram_keeps_linear_axes_and_may_shift_the_programmed_position() -> None:
    bench = Bench(("e1", "a1"))
    panel = make_panel(bench)
    ask(panel, op="fault", forge=[{"offset_deg": 2, "programmed_too": True}])
    bench.cycle()
    forged = bench.pc.decode(bench.krc.forged(panel.forgeries[0]))
    assert np.rad2deg(forged.q) == pytest.approx([0.0, 2.0], abs=1e-3)
    assert np.rad2deg(forged.q_programmed) == pytest.approx([0.0, 2.0], abs=1e-3)


def test_an_awaited_state_is_answered_in_its_cycle() -> None:
    bench = Bench(late_budget=8)
    panel = make_panel(bench)
    bench.cycle()  # a sensor that never replied is not missed
    stopped, fifth = later(panel, state="stopped"), later(panel, cycles=5)
    for cycles in range(1, 20):
        bench.silent()
        panel.cycle_passed()
        assert len(fifth) == int(cycles >= 5)
        assert len(stopped) == int(bench.krc.state is KrcState.STOPPED)
    assert [answer["state"] for answer in (*fifth, *stopped)] == ["RSI running", "stopped"]


def test_an_awaited_state_that_holds_already_is_answered_at_once() -> None:
    (answer,) = later(make_panel(Bench()), state="RSI running", at_rest=True)
    assert answer["ok"]


def test_rest_is_awaited_until_the_drives_have_caught_up() -> None:
    bench = Bench(servo_lag=ServoLag(dead_time_s=0.012, natural_frequency_rad_s=60.0))
    panel = make_panel(bench)
    bench.cycle(0.001)
    bench.krc.tick()
    arrived = later(panel, at_rest=True)
    assert arrived == []
    while not arrived:
        bench.cycle(0.001)
        panel.cycle_passed()
    assert arrived[0]["q"] == pytest.approx([0.001] * 6, abs=2e-5)


def test_a_timeout_is_reported_with_the_present_state(bench: Bench) -> None:
    panel = make_panel(bench)
    never = later(panel, state="drives off", within_s=0.03)
    for _ in range(3):
        assert never == []
        bench.cycle()
        panel.cycle_passed()
    (answer,) = never
    assert not answer["ok"]
    assert answer["error"].startswith("not within 0.03 s: RSI running, 0.0000")
    assert answer["error"].endswith("3 cycles later")


def test_too_many_waiting_requests_are_refused() -> None:
    panel = make_panel(Bench())
    waiting = [later(panel, cycles=9) for _ in range(MAX_AWAITED)]
    assert not any(waiting)
    (answer,) = later(panel, cycles=9)
    assert answer["error"] == "64 requests await their answer already"


@pytest.mark.parametrize(
    ("request_bytes", "message"),
    [
        (b"", "Invalid JSON"),
        (b"[]", "request: "),
        (b'{"op": "explode"}', "'status'"),
        (b'{"op": "mode", "mode": "T3"}', "mode: Input should be 'T1', 'T2' or 'AUT'"),
        (b'{"op": "acknowledge"}', "'acknowledge' is not possible while RSI running"),
        (b'{"op": "await", "state": "asleep"}', "await.state: Input should be 'drives off'"),
        (b'{"op": "await", "within_s": 0}', "await.within_s: Input should be greater than 0"),
        (b'{"op": "fault", "drop": 2}', "less than or equal to 1"),
        (b'{"op": "fault", "forge": [{"address": "10.0.0.1"}]}', "String should match pattern"),
        (b'{"op": "fault", "forge": [{}, 7]}', "fault.forge.1: Input should be"),
        (b'{"op": "restart", "correction": "both"}', "Input should be 'absolute' or 'relative'"),
        (b'{"op": "confirm"}', "'confirm' is not possible while RSI running"),
        (b'{"op": "fault", "dropp": 1}', "Extra inputs are not permitted"),
        (b'{"op": "input", "name": "door", "value": true}', "no digital input 'door'; this robot has closed"),
        (b" " * 5000, "at most 4096 bytes"),
    ],
)
def test_an_impossible_request_is_answered_with_the_reason(request_bytes: bytes, message: str) -> None:
    (answer,) = answers(make_panel(Bench()), request_bytes)
    assert answer["ok"] is False
    assert message in answer["error"]


@pytest.mark.long
@given(st.binary(max_size=200))
def test_the_panel_answers_every_datagram(request_bytes: bytes) -> None:
    (answer,) = answers(make_panel(Bench()), request_bytes)
    assert answer["ok"] or answer["error"]


def test_the_shipped_settings_open_the_makers_limits_and_can_be_loaded() -> None:
    assert KrcSettings().correction_limit_deg == 5
    assert KrcSettings().monitor_limit_mm == 6
    shipped = KrcSettings.load()
    assert shipped.correction_limit_deg > 690
    assert shipped.monitor_limit_deg > shipped.correction_limit_deg
    assert shipped.correction == "absolute"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "late_buget: 3",
            "late_buget: Extra inputs are not permitted, got 3; allowed settings are correction",
        ),
        ("correction_limit_deg: -1", "correction_limit_deg: Input should be greater than 0, got -1"),
        ("a: [", "cannot be read"),
        ("- a", "file: "),
    ],
)
def test_a_setting_that_is_not_allowed_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    with pytest.raises(SettingsError) as caught:
        KrcSettings.load(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


def test_missing_settings_are_reported(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot be read"):
        KrcSettings.load(tmp_path / "none.yaml")


def test_a_controller_accepts_only_its_own_cycle_times() -> None:
    assert profile_for("krc2", 0.012).ipoc_only_first
    assert profile_for("krc4", 0.004).reply_within == 1.0
    with pytest.raises(SettingsError, match=r"cycle_s is 0\.004: a krc2 runs at 12 ms"):
        profile_for("krc2", 0.004)
    with pytest.raises(SettingsError, match="allowed is krc2 or krc4"):
        profile_for("krc5", 0.004)


def test_a_record_can_be_read_while_it_grows(bench: Bench, tmp_path: Path) -> None:
    recorder = CsvRecorder(0.012, 6)
    recorder.row(bench.krc.sample)
    recorder.start(tmp_path / "run.csv")
    for k in range(3):
        bench.cycle(0.001 * k)
        recorder.row(bench.krc.sample)
        lines = (tmp_path / "run.csv").read_text().splitlines()
        assert len(lines) == 2 + k
    names, values = lines[0].split(","), lines[-1].split(",")
    assert names == [
        "cycle",
        "time_s",
        *(f"q_{i}" for i in range(1, 7)),
        *(f"q_set_{i}" for i in range(1, 7)),
        "state",
    ]
    assert values[:2] == ["3", "0.036"]
    assert np.array(values[8:14], float) == pytest.approx([0.001] * 6, abs=1e-8)
    assert values[-1] == "RSI running"
    # a reader that keeps it short
    os.truncate(tmp_path / "run.csv", 0)
    recorder.row(bench.krc.sample)
    assert (tmp_path / "run.csv").read_text().splitlines() == [lines[-1]]
    recorder.stop()
