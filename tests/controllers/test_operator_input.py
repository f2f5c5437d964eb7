""""""

import os
import pty
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from advising import advised
from driving import CYCLE_S, PlainDrive, model

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.keyboard import (
    FIRST_REPEAT_S,
    HOLD_S,
    TAP_S,
    TAP_SHARE,
    HeldKey,
    Keyboard,
)
from deltaq_controllers.operator_input.script import Script
from deltaq_protocol.driving import DrivingMode, Frame, Grip, OperatorCommand


def teleoperator(robot: str = "gr", mode: DrivingMode = DrivingMode.JOINT) -> Teleoperator:
    return Teleoperator(model(robot), CYCLE_S, mode)


def script(folder: Path, text: str, mode: DrivingMode = DrivingMode.JOINT) -> Script:
    file = folder / "task.yaml"
    file.write_text(text, encoding="utf-8")
    return Script.load(file, teleoperator(mode=mode))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "a script is a list of steps such as"),
        ("duration_s: 1", "a script is a list of steps such as"),
        ("- {duration_s: 1", "task.yaml:2: not YAML: did not find expected"),
        ("- {duration_s: 1}\n- 7", "task.yaml:2: Input should be a valid dictionary.*got 7"),
        ("- {duration: 1}", "task.yaml:1: duration_s: Field required"),
        ("- {duration_s: 0}", r"task.yaml:1: duration_s: Input should be greater than 0; got 0"),
        ("- {duration_s: 1, move: {a1_deg_s: .nan}}", r"task.yaml:1: move.a1_deg_s: .*finite number"),
        ("- {duration_s: 1, speed: 3}", "task.yaml:1: speed: Extra inputs are not permitted"),
        ("- {duration_s: 1, move: {a1: 3}}", "a1: not an axis with its unit; axes are e1, e2"),
        ("- {duration_s: 1, move: {a1_m_s: 3}}", "a1 is in rad; write a1_rad_s or a1_deg_s"),
        ("- {duration_s: 1, move: {e1_deg_s: 3}}", "e1 is in m; write e1_m_s or e1_mm_s"),
        (
            "- {duration_s: 1, outputs: {griper: on}}",
            "task.yaml:1: output 'griper' is unknown; robot gr has gripper, tool_changer",
        ),
        ("- {duration_s: 1, outputs: {gripper: shut}}", r"outputs.gripper: .*boolean.*got 'shut'"),
        ("- {duration_s: 1, move: {x_m_s: 3}}", "task.yaml:1: axis 'x' is not driven in mode joint"),
        (
            "- {duration_s: 1, mode: fly}",
            "Input should be 'joint', 'decoupled', 'self-motion', 'advisor' or 'coupled'",
        ),
    ],
)
def test_a_bad_script_is_refused_with_its_line_and_the_allowed_values(
    tmp_path: Path, text: str, told: str
) -> None:
    with pytest.raises(ControllerError, match=told):
        script(tmp_path, text)


def test_a_missing_script_is_named(tmp_path: Path) -> None:
    with pytest.raises(ControllerError, match=r"missing.yaml: cannot be read: No such file"):
        Script.load(tmp_path / "missing.yaml", teleoperator())


def test_a_script_runs_its_steps_in_order_and_si_units_from_the_first_reading_on(
    tmp_path: Path,
) -> None:
    steps = script(
        tmp_path,
        """\
- {duration_s: 1, move: {a1_deg_s: 90, e1_mm_s: 20}}
- {duration_s: 0.5}
- {duration_s: 2, mode: coupled, frame: tool, move: {x_m_s: 0.1}}
""",
    )
    assert steps.read(100.0) == OperatorCommand({"a1": pytest.approx(np.pi / 2), "e1": pytest.approx(0.02)})
    assert steps.read(100.99) == steps.read(100.5)
    assert steps.read(101.0) == OperatorCommand()
    assert steps.read(101.5) == OperatorCommand({"x": 0.1}, DrivingMode.COUPLED, Frame.TOOL)
    assert steps.read(103.5) is None


def test_a_step_switches_outputs_and_the_next_keeps_them(tmp_path: Path) -> None:
    steps = script(
        tmp_path,
        "- {duration_s: 1, move: {a1_rad_s: 0.1}, outputs: {gripper: on, tool_changer: off}}\n- {duration_s: 1}",
    )
    assert steps.read(0.0) == OperatorCommand({"a1": 0.1}, outputs={"gripper": True, "tool_changer": False})
    assert steps.read(1.0) == OperatorCommand()


def test_a_robot_without_outputs_refuses_to_switch_one() -> None:
    operator = teleoperator("fr")
    with pytest.raises(ControllerError, match="output 'gripper' is unknown; robot fr has no outputs"):
        operator.check(OperatorCommand(outputs={"gripper": True}), DrivingMode.JOINT)
    terminal = Terminal(operator)
    with terminal.keyboard:
        assert terminal.press("g.,", 1.0) == OperatorCommand()
        assert "output" not in terminal.keyboard.status
    terminal.close()


def test_a_step_to_an_option_ends_on_arrival_or_after_its_duration() -> None:
    there: list[int | None] = [None]
    steps = Script(
        [(60.0, OperatorCommand(option=2)), (5.0, OperatorCommand(option=3)), (1.0, OperatorCommand())],
        lambda: there[-1],
    )
    assert steps.read(10.0) == OperatorCommand(option=2)
    assert steps.read(30.0) == OperatorCommand(option=2)
    there.append(2)
    assert steps.read(31.0) == OperatorCommand(option=3)
    assert steps.read(35.9) == OperatorCommand(option=3)
    assert steps.read(36.0) == OperatorCommand()
    assert steps.read(37.0) is None


def test_the_duration_of_a_step_to_an_option_begins_with_the_answer_of_the_advisor() -> None:
    awaits = [True]
    steps = Script(
        [(5.0, OperatorCommand(option=1)), (1.0, OperatorCommand())], awaits_advice=lambda: awaits[-1]
    )
    assert steps.read(10.0) == OperatorCommand(option=1)
    assert steps.read(100.0) == OperatorCommand(option=1)
    awaits.append(False)
    assert steps.read(104.9) == OperatorCommand(option=1)
    assert steps.read(105.0) == OperatorCommand()
    awaits.append(True)
    assert steps.read(106.0) is None


class Terminal:
    """A keyboard in a terminal of its own."""

    def __init__(self, operator: Teleoperator) -> None:
        self.keys, self._terminal = pty.openpty()
        self.keyboard = Keyboard(operator, self._terminal)

    def press(self, text: str, time_s: float) -> OperatorCommand | None:
        os.write(self.keys, text.encode())
        return self.keyboard.read(time_s)

    def close(self) -> None:
        os.close(self.keys)
        os.close(self._terminal)


SLOW = pytest.approx(0.1 * TAP_SHARE)


def test_a_tapped_key_moves_slowly_for_a_while_and_no_key_means_rest() -> None:
    terminal = Terminal(teleoperator(mode=DrivingMode.COUPLED))
    with terminal.keyboard:
        assert terminal.press("w", 10.0) == OperatorCommand({"x": SLOW})
        assert terminal.press("", 10.0 + 0.9 * FIRST_REPEAT_S) == OperatorCommand({"x": SLOW})
        assert terminal.press("", 10.0 + FIRST_REPEAT_S) == OperatorCommand()
        assert terminal.press("w ", 11.0) == OperatorCommand()
        assert terminal.press("+d", 12.0) == OperatorCommand({"y": pytest.approx(-0.15 * TAP_SHARE)})
        assert terminal.press("q", 12.0) is None
    terminal.close()


def test_arrow_keys_choose_and_drive_a_joint_even_with_split_escape_sequences() -> None:
    terminal = Terminal(teleoperator())
    with terminal.keyboard:
        assert terminal.press("\x1b[C\x1b[A", 1.0) == OperatorCommand({"e2": SLOW})
        assert terminal.press("\x1b[", 2.0) == OperatorCommand()
        assert terminal.press("B", 2.0) == OperatorCommand({"e2": pytest.approx(-0.1 * TAP_SHARE)})
        assert terminal.press("\x1b[C\x1b[C\x1b[A", 3.0) == OperatorCommand(
            {"a1": pytest.approx(0.35 * TAP_SHARE)}
        )
        assert "joint a1" in terminal.keyboard.status
    terminal.close()


def test_keys_cycle_through_the_modes_and_hands_of_the_robot() -> None:
    operator = teleoperator("fr", DrivingMode.DECOUPLED)
    terminal = Terminal(operator)
    with terminal.keyboard:
        assert terminal.press("m", 1.0) == OperatorCommand(
            mode=DrivingMode.COUPLED
        )  # not redundant: no self-motion
        assert terminal.press("t", 1.0) == OperatorCommand(frame=Frame.TOOL)
    terminal.close()
    terminal = Terminal(teleoperator("dawm", DrivingMode.COUPLED))
    with terminal.keyboard:
        assert terminal.press("h r", 1.0) == OperatorCommand({"left.z": SLOW}, grip=Grip.FREE)
        assert terminal.press("h r", 1.0) == OperatorCommand({"right.z": SLOW}, grip=Grip.FREE)
        assert terminal.press("h r", 1.0) == OperatorCommand({"z": SLOW}, grip=Grip.OBJECT)
        assert terminal.press("h r", 1.0) == OperatorCommand({"z": SLOW}, grip=Grip.FREE)
    terminal.close()


def test_keys_switch_the_chosen_output_and_stop_the_hand() -> None:
    terminal = Terminal(teleoperator(mode=DrivingMode.COUPLED))
    with terminal.keyboard:
        assert terminal.press("w", 1.0) == OperatorCommand({"x": SLOW})
        assert terminal.press(".", 1.1) == OperatorCommand(outputs={"gripper": True})
        assert terminal.press("", 1.2) == OperatorCommand()
        assert terminal.press("g,", 1.3) == OperatorCommand(outputs={"tool_changer": False})
        assert "output tool_changer" in terminal.keyboard.status
        assert terminal.press("g", 1.4) == OperatorCommand()
        assert terminal.press(".,", 1.5) == OperatorCommand(outputs={"gripper": False})
    terminal.close()


def test_a_digit_drives_to_an_option_until_another_key_is_pressed() -> None:
    terminal = Terminal(advised(model("gr")))
    with terminal.keyboard:
        assert terminal.press("2", 1.0) == OperatorCommand(option=2)
        assert terminal.press("", 9.0) == OperatorCommand(option=2)
        assert terminal.press(" ", 9.1) == OperatorCommand()
        assert terminal.press("3", 9.2) == OperatorCommand(option=3)
        assert terminal.press("m", 9.3) == OperatorCommand(mode=DrivingMode.COUPLED)
    terminal.close()
    terminal = Terminal(teleoperator())
    with terminal.keyboard:
        assert terminal.press("2", 1.0) == OperatorCommand()
    terminal.close()


def test_a_keyboard_without_a_terminal_is_refused_with_alternatives() -> None:
    read, write = os.pipe()
    with pytest.raises(ControllerError, match="needs a terminal; from a pipe use a script"):
        Keyboard(teleoperator(), read).__enter__()
    os.close(read)
    os.close(write)


# Keys as terminals repeat them, driven in virtual time.


SPEED_M_S = 0.1

REPEATS = {
    "a PC's own": (0.5, 1 / 10.9),
    "X11": (0.66, 1 / 25),
    "GNOME": (0.5, 1 / 33),
    "macOS, quickest": (0.225, 1 / 30),
    "Windows, quickest": (0.25, 1 / 31),
}
"""Seconds from the press to the first repeat, and between repeats, as desktops are set."""


def repeated(delay_s: float, interval_s: float, held_s: float) -> list[float]:
    """When a terminal tells of a key that is held from 0 for a time, a few milliseconds early or late."""
    jitter = np.random.default_rng(3).uniform(-0.005, 0.005, 1000)
    repeats = np.arange(delay_s, held_s, interval_s)
    return [0.0, *(repeats + jitter[: len(repeats)]).tolist()]


def driven(presses: Sequence[float], until_s: float) -> np.ndarray:
    """(T, 3) where the hand is commanded to be in every cycle, with key w pressed at these times."""
    keys, terminal = pty.openpty()
    drive = PlainDrive("gr", DrivingMode.COUPLED)
    waiting, places = list(presses), []
    with Keyboard(drive.teleoperator, terminal, SPEED_M_S) as keyboard:
        for cycle in range(round(until_s / CYCLE_S)):
            time_s = cycle * CYCLE_S
            while waiting and waiting[0] <= time_s:
                os.write(keys, b"w")
                waiting.pop(0)
            command = keyboard.read(time_s)
            assert command is not None
            drive.step(command)
            places.append(drive.robot.forward(drive.now)[:3, 3])
    os.close(keys)
    os.close(terminal)
    assert drive.violations == 0
    return np.array(places)


def speeds(places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(places, axis=0), axis=1) / CYCLE_S


def test_a_tap_moves_by_as_much_as_full_speed_in_a_tenth_of_a_second() -> None:
    places = driven([0.0], 2.0)
    assert np.linalg.norm(places[-1] - places[0]) == pytest.approx(SPEED_M_S * TAP_S, rel=0.05)
    assert speeds(places).max() < 0.2 * SPEED_M_S


@pytest.mark.parametrize("setting", REPEATS)
def test_a_held_key_moves_without_a_pause_and_stops_soon_after_its_release(setting: str) -> None:
    presses = repeated(*REPEATS[setting], held_s=2.0)
    places = driven(presses, 3.0)
    speed = speeds(places)
    last = presses[-1]
    held = speed[round(0.1 / CYCLE_S) : round(last / CYCLE_S)]
    assert held.min() > 0.1 * SPEED_M_S, "it never stands while the key is held"
    assert speed[round(1.2 / CYCLE_S) : round(last / CYCLE_S)].min() > 0.95 * SPEED_M_S
    released = round(last / CYCLE_S)
    assert np.linalg.norm(places[-1] - places[released]) < SPEED_M_S * (HOLD_S + 0.05)
    assert speed[-1] < 1e-6


def test_two_taps_are_no_hold_and_the_next_key_starts_a_new_motion() -> None:
    key = HeldKey()
    for time_s in (0.0, 0.5):
        key.press("w", time_s)
        assert 0.0 < key.share(time_s) < 0.2
    assert key.share(0.5 + HOLD_S) == 0.0
    for time_s in (1.0, 1.5, 1.53):
        key.press("w", time_s)
    assert key.share(1.6) == 1.0
    key.press("s", 1.6)
    assert 0.0 < key.share(1.6 + 0.9 * FIRST_REPEAT_S) < 0.2
    key.release()
    assert key.share(1.7) == 0.0


def test_a_key_pressed_again_after_a_hold_starts_a_new_motion() -> None:
    key = HeldKey()
    for time_s in (0.0, 0.5, 0.53, 0.56):
        key.press("w", time_s)
    assert key.share(0.56 + HOLD_S) == 0.0
    key.press("w", 0.9)
    assert 0.0 < key.share(0.9 + 0.9 * FIRST_REPEAT_S) < 0.2
