"""The controller's end of RSI: writes telegrams byte by byte as a KRC does, reads the replies."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi.axes import DEG_PER_RAD, MM_PER_M, POSE_AXES, AxisMap
from deltaq_protocol.rsi.errors import TelegramError
from deltaq_protocol.rsi.ethernet_xml import ElementType, EthernetConfig
from deltaq_protocol.rsi.layout import (
    MAX_IPOC,
    NUMBER,
    Field,
    correction_fields,
    digital_fields,
    document,
    receive_fields,
    send_fields,
)

MAX_TELEGRAM_BYTES = 4096
MAX_PRECISION = 9

# as C's strtod reads it: a zero before the point may be missing
_NUMBER = re.compile(rf"{NUMBER}|[-+]?\.[0-9]{{1,16}}(?:[eE][-+]?[0-9]{{1,2}})?")
_STOP = "driver.stop"
"""Key of the stop among the outputs; no output can have this name."""
_POSE_SCALE = (MM_PER_M,) * 3 + (DEG_PER_RAD,) * 3
# where the value of a field comes from, as rows of one table of lists
_Q, _Q_PROGRAMMED, _POSE, _POSE_PROGRAMMED, _DELAY, _INPUTS, _ZERO, _ZERO_COUNT, _EMPTY = range(9)


class KrcReport(NamedTuple):
    """The values that a controller sends in one cycle.

    Attributes:
        q: (n,) measured joints [rad or m].
        q_programmed: (n,) setpoint of the programmed path [rad or m].
        pose: X, Y, Z [m], A, B, C [rad] of the tool, measured; pose_programmed: of the programmed path.
        delay: late packets so far.
        inputs: digital inputs by name.
    """

    ipoc: int
    q: Array
    q_programmed: Array
    pose: tuple[float, ...]
    pose_programmed: tuple[float, ...]
    delay: int
    inputs: Mapping[str, bool]


class SensorTelegram(NamedTuple):
    """A PC's reply.

    Attributes:
        type: its `Type`, which may be the wrong one.
        correction: (n,) [rad or m], zero where the reply had none.
        present: (n,) which joints the reply had a correction for.
        outputs: the digital outputs that the reply had.
        text: for the pendant.
        stop: the signal that ends the motion; None if the reply did not have it.
    """

    type: str
    ipoc: int
    correction: Array
    present: NDArray[np.bool_]
    outputs: dict[str, bool]
    text: str
    stop: bool | None


class KrcCodec:
    """Telegrams of one robot as its controller sees them.

    Motor currents and technology parameters are written as zero: there is no model of them.

    Args:
        config: the `*_ethernet.xml`.
        axes: the robot's joints.
        inputs: per name of a digital input the TAG of its BOOL of SEND.
        outputs: per name of a digital output the TAG of its BOOL of RECEIVE.
        precision: decimals of a DOUBLE in a telegram of the controller.
        stop: TAG of the BOOL of RECEIVE that ends the motion, if there is one.

    Attributes:
        axes: as given.

    Raises:
        EthernetConfigError: if the configuration lacks the correction of a joint or lacks a digital signal.
    """

    def __init__(
        self,
        config: EthernetConfig,
        axes: AxisMap,
        inputs: Mapping[str, str] = MappingProxyType({}),
        outputs: Mapping[str, str] = MappingProxyType({}),
        precision: int = 4,
        stop: str | None = None,
    ) -> None:
        self.config = config
        self.axes = axes
        self._inputs = inputs
        corrections = correction_fields(config, axes)
        self._corrections = [corrections[axis] for axis in axes.axes]
        self._per_commanded = 1.0 / axes.commanded
        self._expected = receive_fields(config)
        # the signal that ends the motion is none of the outputs, and may not be one of them either
        named = dict(outputs) if stop is None else dict(outputs) | {_STOP: stop}
        self._digital = digital_fields(config, "RECEIVE", self._expected, named)
        self._stop = self._digital.pop(_STOP, None)
        self.hold_on = np.array([field.element.hold_on for field in self._corrections])
        """(n,) HOLDON of each joint's correction."""
        self.output_hold_on = {name: field.element.hold_on for name, field in self._digital.items()}
        """HOLDON of each digital output."""
        self.stop_hold_on = self._stop is not None and self._stop.element.hold_on
        """HOLDON of the signal that ends the motion."""
        self._compile_encoder(precision)

    def _compile_encoder(self, precision: int) -> None:
        fields = send_fields(self.config)
        inputs = {
            field: number
            for number, field in enumerate(digital_fields(self.config, "SEND", fields, self._inputs).values())
        }
        self._places: list[tuple[int, int]] = []

        def value(field: Field) -> str:
            self._places.append(self._source(field, inputs))
            kind = field.element.type
            if kind is ElementType.STRING:
                return "%s"
            return f"%.{precision}f" if kind is ElementType.DOUBLE else "%d"

        text = document("Rob", 'Type="KUKA"', fields, value)
        self._template = text.replace("%IPOC%", "%d").encode()

    def _source(self, field: Field, inputs: Mapping[Field, int]) -> tuple[int, int]:
        internal, attribute = field.element.internal, field.attribute
        if internal in ("AIPos", "EIPos", "ASPos", "ESPos") and attribute in self.axes.axes:
            return (_Q if internal[1] == "I" else _Q_PROGRAMMED), self.axes.axes.index(attribute)
        if internal in ("RIst", "RSol") and attribute is not None:
            return (_POSE if internal == "RIst" else _POSE_PROGRAMMED), POSE_AXES.index(attribute)
        if internal == "Delay":
            return _DELAY, 0
        if field in inputs:
            return _INPUTS, inputs[field]
        by_type = {ElementType.DOUBLE: _ZERO, ElementType.STRING: _EMPTY}
        return by_type.get(field.element.type, _ZERO_COUNT), 0

    def encode(self, report: KrcReport) -> bytes:
        """The telegram of one cycle, in the compact form: nothing between elements, IPOC last."""
        table: tuple[list[object], ...] = (
            (report.q * self.axes.reported).tolist(),
            (report.q_programmed * self.axes.reported).tolist(),
            [value * scale for value, scale in zip(report.pose, _POSE_SCALE, strict=True)],
            [value * scale for value, scale in zip(report.pose_programmed, _POSE_SCALE, strict=True)],
            [report.delay],
            [bool(report.inputs.get(name)) for name in self._inputs],
            [0.0],
            [0],
            [b""],
        )
        return self._template % (*[table[row][column] for row, column in self._places], report.ipoc)

    @staticmethod
    def encode_ipoc_only(ipoc: int) -> bytes:
        """The first telegram of a KR C2."""
        return b'<Rob Type="KUKA"><IPOC>%d</IPOC></Rob>' % ipoc

    def decode(self, datagram: bytes) -> SensorTelegram:
        """Read a reply; elements may come in any order; unknown ones are skipped, and so is the end of a C string.

        Raises:
            TelegramError: if it is no reply of this configuration, with what is wrong.
        """
        root = self._parse(datagram)
        ipoc_text = (root.findtext("IPOC") or "").strip()
        if re.fullmatch(r"[0-9]{1,10}", ipoc_text) is None or int(ipoc_text) > MAX_IPOC:
            raise TelegramError(f"IPOC is {ipoc_text[:20]!r}, allowed is a number of 32 bit")
        correction = np.zeros(len(self._corrections))
        present = np.zeros(len(self._corrections), dtype=np.bool_)
        elements: dict[str, ET.Element] = {}
        for element in root:
            elements.setdefault(element.tag, element)
        for number, field in enumerate(self._corrections):
            if (text := self._text(elements, field)) is not None:
                correction[number] = self._number(field, text)
                present[number] = True
        outputs = {
            name: self._number(field, text) != 0.0
            for name, field in self._digital.items()
            if (text := self._text(elements, field)) is not None
        }
        stop = None
        if self._stop is not None and (text := self._text(elements, self._stop)) is not None:
            stop = self._number(self._stop, text) != 0.0
        return SensorTelegram(
            root.get("Type", ""),
            int(ipoc_text),
            correction * self._per_commanded,
            present,
            outputs,
            (root.findtext("EStr") or "").strip(),
            stop,
        )

    @staticmethod
    def _parse(datagram: bytes) -> ET.Element:
        if len(datagram) > MAX_TELEGRAM_BYTES:
            raise TelegramError(f"{len(datagram)} bytes long, at most {MAX_TELEGRAM_BYTES} are allowed")
        datagram = datagram.rstrip(b"\0")
        # without declarations there are no entities to expand and no encodings to guess
        if not datagram.isascii() or b"<!" in datagram or b"<?" in datagram:
            raise TelegramError(f"only plain ASCII elements are allowed, got {datagram[:80]!r}")
        try:
            root = ET.fromstring(datagram)
        except (ET.ParseError, ValueError) as error:
            raise TelegramError(f"no XML document: {error}; got {datagram[:80]!r}") from error
        if root.tag != "Sen" or "Type" not in root.attrib:
            raise TelegramError(f'a reply is a <Sen Type="…"> element, got {datagram[:80]!r}')
        return root

    @staticmethod
    def _text(elements: Mapping[str, ET.Element], field: Field) -> str | None:
        if (element := elements.get(field.group)) is None:
            return None
        return element.text or "" if field.attribute is None else element.get(field.attribute)

    @staticmethod
    def _number(field: Field, text: str) -> float:
        text = text.strip()
        if _NUMBER.fullmatch(text) is None:
            raise TelegramError(f"{field.element.tag} is {text[:40]!r}, allowed is a decimal number")
        return float(text)
