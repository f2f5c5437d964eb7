"""The controller's end of RSI: writes telegrams byte by byte as a KRC does, reads the replies."""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi.axes import DEG_PER_RAD, MM_PER_M, POSE_AXES, AxisMap, TelegramError
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

# as C's strtod reads it: a zero before the point may be missing
_NUMBER = re.compile(rf"{NUMBER}|[-+]?\.[0-9]{{1,16}}(?:[eE][-+]?[0-9]{{1,2}})?")
_MARKUP = re.compile(rb"""<[^<>"']*(?:"[^"]*"[^<>"']*|'[^']*'[^<>"']*)*>""")
_NAME_OR_VALUE = re.compile(rb""""[^"]*"|'[^']*'|(?<![\w.-])[0-9][\w-]*""")
_PLAIN_TEXT = r"[ !#-%\'-;=?-~]*"
"""Printable ASCII without XML's special characters."""
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
    """Codec of one robot's telegrams at the controller's end.

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
        # the signal that ends the motion must not be one of the outputs
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
        self._compile_decoder()

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

    def _compile_decoder(self) -> None:
        """The pattern of a reply as our PC writes it: everything there, in order, and nothing between elements."""
        read = {*self._corrections, *self._digital.values(), self._stop}
        captured: list[Field] = []

        def value(field: Field) -> str:
            is_text = field.element.internal == "EStr"
            if field not in read and not is_text:
                return _PLAIN_TEXT
            captured.append(field)
            return f"({_PLAIN_TEXT if is_text else NUMBER})"

        pattern = document("Sen", f'Type="({_PLAIN_TEXT})"', self._expected, value)
        self._compact = re.compile(pattern.replace("%IPOC%", "([0-9]{1,10})").encode() + rb"\0*")
        # the first group is the type, the last one the IPOC
        place = {field: number for number, field in enumerate(captured, 1)}
        self._correction_places = [place[field] for field in self._corrections]
        self._output_places = {name: place[field] for name, field in self._digital.items()}
        self._stop_place = None if self._stop is None else place[self._stop]
        texts = [place[field] for field in captured if field.element.internal == "EStr"]
        self._text_place = texts[0] if texts else None
        self._all_present = np.ones(len(self._corrections), dtype=np.bool_)
        self._all_present.flags.writeable = False

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
            TelegramError: if it is no reply of this configuration; the message says why.
        """
        match = self._compact.fullmatch(datagram) if len(datagram) <= MAX_TELEGRAM_BYTES else None
        if match is None:
            return self._decode_any(datagram)
        values = match.groups()
        ipoc = int(values[-1])
        if ipoc > MAX_IPOC:
            raise _ipoc_error(values[-1].decode())
        correction = np.array([float(values[place]) for place in self._correction_places])
        return SensorTelegram(
            values[0].decode(),
            ipoc,
            correction * self._per_commanded,
            self._all_present,
            {name: float(values[place]) != 0.0 for name, place in self._output_places.items()},
            "" if self._text_place is None else values[self._text_place].decode().strip(),
            None if self._stop_place is None else float(values[self._stop_place]) != 0.0,
        )

    def _decode_any(self, datagram: bytes) -> SensorTelegram:
        """Read a reply in any form that a controller takes, several times slower."""
        root = self._parse(datagram)
        ipoc_text = (root.findtext("IPOC") or "").strip()
        if re.fullmatch(r"[0-9]{1,10}", ipoc_text) is None or int(ipoc_text) > MAX_IPOC:
            raise _ipoc_error(ipoc_text)
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
            root = ET.fromstring(_MARKUP.sub(_with_xml_names, datagram))
        except (ET.ParseError, ValueError) as error:
            raise TelegramError(f"no XML document: {error}; got {datagram[:80]!r}") from error
        if root.tag != "Sen" or "Type" not in root.attrib:
            raise TelegramError(f'a reply is a <Sen Type="…"> element, got {datagram[:80]!r}')
        return root

    @staticmethod
    def _text(elements: Mapping[str, ET.Element], field: Field) -> str | None:
        if (element := elements.get(_xml_name(field.group))) is None:
            return None
        return element.text or "" if field.attribute is None else element.get(_xml_name(field.attribute))

    @staticmethod
    def _number(field: Field, text: str) -> float:
        text = text.strip()
        if _NUMBER.fullmatch(text) is None:
            raise TelegramError(f"{field.element.tag} is {text[:40]!r}, allowed is a decimal number")
        return float(text)


def _xml_name(name: str) -> str:
    """A name of a telegram as an XML document may have it, where none begins with a digit."""
    return f"_.{name}" if name[0].isdigit() else name


def _with_xml_names(markup: re.Match[bytes]) -> bytes:
    return _NAME_OR_VALUE.sub(lambda name: name[0] if name[0][:1] in b"\"'" else b"_." + name[0], markup[0])


def _ipoc_error(text: str) -> TelegramError:
    return TelegramError(f"IPOC is {text[:20]!r}, allowed is a number of 32 bit")


def pose_from_matrix(T: Array) -> tuple[float, float, float, float, float, float]:
    """X, Y, Z [m] and A, B, C [rad] of a (4, 4) transform; where B is ±90 degrees, C is 0."""
    (r11, r12, _, x), (r21, r22, _, y), (r31, r32, r33, z), _ = T.tolist()
    level = math.hypot(r11, r21)
    b = math.atan2(-r31, level)
    if level > 1e-9:
        return x, y, z, math.atan2(r21, r11), b, math.atan2(r32, r33)
    return x, y, z, math.atan2(-r12, r22), b, 0.0
