"""`deltaq drive --input spacemouse`: the reports of the device, and what becomes of them.

There is no device here, nor a way to plug in a virtual one: bytes stand for its reports, and of hidapi what it does
without a device is tested.
"""

import struct

import pytest
from driving import CYCLE_S, model
from hypothesis import given
from hypothesis import strategies as st
from test_operator_input import Terminal

from deltaq_controllers.interface import ControllerError
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.interface import DEAD_ZONE
from deltaq_controllers.operator_input.spacemouse import (
    FULL,
    MOST,
    NEXT_HAND,
    RUN,
    SETTLE_S,
    STALE_S,
    SixAxis,
    SixAxisState,
    SpaceMouse,
    is_spacemouse,
)
from deltaq_protocol.driving import HAND_AXES, DrivingMode, OperatorCommand

RIGHT, BACK, DOWN = (FULL, 0, 0), (0, FULL, 0), (0, 0, FULL)
NOTHING = (0, 0, 0)
REST = dict.fromkeys(HAND_AXES, 0.0)


def translation(numbers: tuple[int, ...]) -> bytes:
    return b"\x01" + struct.pack("<3h", *numbers)


def rotation(numbers: tuple[int, ...]) -> bytes:
    return b"\x02" + struct.pack("<3h", *numbers)


def both(numbers: tuple[int, ...]) -> bytes:
    return b"\x01" + struct.pack("<6h", *numbers)


def buttons(*held: int) -> bytes:
    return b"\x03" + sum(1 << button for button in held).to_bytes(2, "little")


class Cap:
    """A controller that was found a while ago, its cap let go; time goes on by a cycle with each look."""

    def __init__(self, *at_first: bytes) -> None:
        self.core, self.time_s = SixAxis(), 0.0
        assert self.look(*at_first).rates == REST
        self.time_s += SETTLE_S
        assert self.look(*at_first).rates == REST

    def look(self, *reports: bytes) -> SixAxisState:
        self.time_s += CYCLE_S
        return self.core.look(reports, self.time_s)


# --- what must not move ---------------------------------------------------------------------------------------


REPORTS = st.lists(
    st.lists(st.binary(max_size=16) | st.binary(min_size=7, max_size=7).map(lambda b: b"\x01" + b[1:]))
)


@pytest.mark.long
@given(REPORTS)
def test_no_bytes_end_a_drive_or_ask_for_more_than_full_speed(cycles: list[list[bytes]]) -> None:
    cap = Cap()
    for reports in cycles:
        state = cap.look(*reports)
        assert set(state.rates) == set(HAND_AXES)
        assert all(-1.0 <= rate <= 1.0 for rate in state.rates.values())
        assert all(0 <= button < 48 for button in (*state.held, *state.pressed))
    assert cap.core.ignored <= sum(map(len, cycles))


def well_formed(report: bytes) -> bool:
    if report[:1] == b"\x03":
        return 1 < len(report) <= 7
    size = {1: (7, 13), 2: (7,)}.get(report[0] if report else -1, ())
    if len(report) not in size:
        return False
    return max(map(abs, struct.unpack(f"<{len(report) // 2}h", report[1:]))) <= MOST


@given(st.lists(st.binary(max_size=14)))
def test_malformed_reports_are_counted_and_keep_the_deflection(reports: list[bytes]) -> None:
    garbage = [report for report in reports if not well_formed(report)]
    cap = Cap()
    before = cap.look(translation(BACK), buttons(RUN))
    after = cap.look(*garbage)
    assert cap.core.ignored == len(garbage)
    assert (after.rates, after.held) == (before.rates, before.held)


@pytest.mark.parametrize(
    "report",
    [
        b"",
        b"\x01",
        translation(RIGHT)[:-1],
        translation(RIGHT) + b"\0",
        both((0,) * 6)[:-1],
        b"\x02" + both((0,) * 6)[1:],
        translation((MOST + 1, 0, 0)),
        translation((0, -32768, 0)),
        b"\x03",
        b"\x03" + bytes(7),
        b"\x17\x64",
    ],
)
def test_a_report_that_is_cut_or_out_of_range_is_ignored(report: bytes) -> None:
    cap = Cap()
    assert cap.look(report).rates == REST
    assert cap.core.ignored == 1


def test_a_cap_deflected_at_the_start_must_be_released_first() -> None:
    cap = Cap(translation(BACK))
    assert cap.look(translation(BACK)).rates == REST
    assert cap.look(translation((FULL, FULL, 0)), rotation(RIGHT)).rates == REST, "one axis was never let go"
    assert not cap.core.is_armed
    cap.look(rotation(NOTHING))
    cap.look(translation(NOTHING))
    assert cap.look(translation(BACK)).rates["x"] == -1.0


def test_a_button_held_at_the_start_is_no_press() -> None:
    cap = SixAxis()
    assert cap.look([buttons(RUN)], 0.0) == cap.look([], SETTLE_S) == SixAxisState(REST)
    cap = Cap()
    cap.look(buttons())
    assert cap.look(buttons(RUN)) == SixAxisState(REST, frozenset({RUN}), (RUN,))
    assert cap.look() == SixAxisState(REST, frozenset({RUN}))


def test_a_silent_deflected_cap_means_rest_until_it_was_released() -> None:
    cap = Cap()
    assert cap.look(translation(BACK)).rates["x"] == -1.0
    cap.time_s += STALE_S
    assert cap.look().rates == REST
    assert cap.look(translation(BACK)).rates == REST
    cap.look(translation(NOTHING))
    assert cap.look(translation(BACK)).rates["x"] == -1.0


def test_an_unplugged_device_is_found_again() -> None:
    cap = Cap()
    cap.look(translation(BACK), buttons(RUN))
    cap.core.forget()
    assert cap.look(translation(BACK)) == SixAxisState(REST)


# --- what moves -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("report", "axis", "rate"),
    [
        (translation(RIGHT), "y", -1.0),
        (translation(BACK), "x", -1.0),
        (translation(DOWN), "z", -1.0),
        (rotation(RIGHT), "ry", -1.0),
        (rotation(BACK), "rx", -1.0),
        (rotation(DOWN), "rz", -1.0),
        (translation((0, -FULL, 0)), "x", 1.0),
        (both((0, 0, 0, 0, 0, -FULL)), "rz", 1.0),
        (both((-FULL, 0, 0, 0, 0, 0)), "y", 1.0),
    ],
)
def test_pushed_ahead_is_x_left_is_y_and_lifted_is_z_and_turns_are_about_them(
    report: bytes, axis: str, rate: float
) -> None:
    assert Cap().look(report).rates == REST | {axis: rate}


def test_speed_grows_from_zero_at_the_edge_of_the_dead_zone_and_is_full_beyond_the_end() -> None:
    cap = Cap()
    told = [cap.look(translation((0, -round(share * FULL), 0))).rates["x"] for share in (0.0, 0.5, 1.0, 2.9)]
    assert told == pytest.approx([0.0, (0.5 - DEAD_ZONE) / (1.0 - DEAD_ZONE), 1.0, 1.0])
    assert cap.look(translation((0, -int(DEAD_ZONE * FULL), 0))).rates["x"] == 0.0


def test_separate_reports_of_translation_and_rotation_are_one_deflection() -> None:
    cap = Cap()
    cap.look(translation(DOWN))
    assert cap.look(rotation(RIGHT)).rates == REST | {"z": -1.0, "ry": -1.0}


# --- the command ----------------------------------------------------------------------------------------------


def mouse(terminal: Terminal, operator: Teleoperator) -> SpaceMouse:
    return SpaceMouse(operator, terminal.keyboard)


def test_the_cap_moves_the_hand_only_while_the_left_button_is_held() -> None:
    operator = Teleoperator(model("dawm"), CYCLE_S, DrivingMode.COUPLED)
    terminal, cap = Terminal(operator), Cap()
    device = mouse(terminal, operator)
    keys = OperatorCommand()
    assert device.moved(keys, cap.look(both((0, -FULL, 0, 0, 0, -FULL)))) == keys
    command = device.moved(keys, cap.look(buttons(RUN)))
    assert command is not None
    assert command.rates == {"x": pytest.approx(0.1), "rz": pytest.approx(0.35)}
    command = device.moved(keys, cap.look(buttons(RUN, NEXT_HAND)))
    assert command is not None
    assert command.rates == {"left.x": pytest.approx(0.1), "left.rz": pytest.approx(0.35)}
    assert device.moved(keys, cap.look(buttons())) == keys
    assert device.moved(None, cap.look()) is None
    terminal.close()


def test_in_joint_modes_a_forward_push_drives_the_chosen_joint() -> None:
    operator = Teleoperator(model("gr"), CYCLE_S, DrivingMode.JOINT)
    terminal, cap = Terminal(operator), Cap()
    device = mouse(terminal, operator)
    command = device.moved(OperatorCommand(), cap.look(translation((0, -FULL, 0)), buttons(RUN)))
    assert command == OperatorCommand({"e1": pytest.approx(0.1)}, led="")
    terminal.close()


# --- the device -----------------------------------------------------------------------------------------------


def test_a_missing_device_is_reported_with_alternatives() -> None:
    operator = Teleoperator(model("gr"), CYCLE_S)
    terminal = Terminal(operator)
    with pytest.raises(ControllerError, match=r"no SpaceMouse is plugged in.*`--input keyboard` or"):
        mouse(terminal, operator).__enter__()
    terminal.close()


@pytest.mark.parametrize(
    ("maker", "product", "usage", "taken"),
    [
        (0x256F, 0xC635, (1, 8), True),
        (0x256F, 0xC635, (0, 0), True),
        (0x046D, 0xC626, (1, 8), True),
        (0x256F, 0xC635, (1, 6), False),
        (0x046D, 0xC077, (1, 2), False),
        (0x046D, 0xC077, (1, 8), False),
        (0x1234, 0xC635, (1, 8), False),
    ],
)
def test_mice_and_keyboards_of_the_same_makers_are_ignored(
    maker: int, product: int, usage: tuple[int, int], taken: bool
) -> None:
    found = {"vendor_id": maker, "product_id": product, "usage_page": usage[0], "usage": usage[1]}
    assert is_spacemouse(found) is taken
