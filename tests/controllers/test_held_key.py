"""Keys as terminals repeat them, driven in virtual time."""

from __future__ import annotations

import os
import pty
from collections.abc import Sequence

import numpy as np
import pytest
from driving import CYCLE_S, PlainDrive

from deltaq_controllers.modes.motion import ModeName
from deltaq_controllers.operator_input.keyboard import FIRST_REPEAT_S, HOLD_S, TAP_S, HeldKey, Keyboard

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
    drive = PlainDrive("gr", ModeName.COUPLED)
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
def test_a_held_key_moves_without_a_pause_and_stops_soon_after_it_is_let_go(setting: str) -> None:
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


def test_two_taps_are_no_hold_and_the_next_key_begins_anew() -> None:
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


def test_a_key_pressed_again_after_a_hold_begins_anew() -> None:
    key = HeldKey()
    for time_s in (0.0, 0.5, 0.53, 0.56):
        key.press("w", time_s)
    assert key.share(0.56 + HOLD_S) == 0.0
    key.press("w", 0.9)
    assert 0.0 < key.share(0.9 + 0.9 * FIRST_REPEAT_S) < 0.2
