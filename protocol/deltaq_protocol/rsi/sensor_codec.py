"""The PC's end of RSI: reads what the controller sends, writes the corrections.

A telegram has to be answered within a cycle of 4 or 12 ms, so one regular expression and one bytes template
are compiled beforehand; building XML documents in the loop is four to six times slower.
"""

import re
from collections.abc import Mapping
from operator import itemgetter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi.axes import AxisMap, EthernetConfigError, TelegramError
from deltaq_protocol.rsi.ethernet_xml import ElementType, EthernetConfig
from deltaq_protocol.rsi.layout import (
    DECIMALS,
    NUMBER,
    Field,
    correction_fields,
    digital_fields,
    document,
    receive_fields,
    send_fields,
    usual_telegram,
)

MAX_TELEGRAM_BYTES = 4096
_MAX_CORRECTION = 1e6
# some controllers write TYPE
_TYPE = '(?i:Type)="KUKA"'
_STOP = "driver.stop"
"""The stop among the signals of RECEIVE; no output of a user can have that name."""


class KrcTelegram(NamedTuple):
    """The contents of a controller's telegram.

    Attributes:
        ipoc: time stamp, to be echoed exactly; that of a KRC has 32 bit, and what is read may have more.
        q: (n,) measured joints [rad or m]; None in the first telegram of a KR C2, which has nothing but
            its IPOC.
        delay: late packets so far, as the controller counts them; None if it does not send them.
        inputs: digital inputs by name.
        q_programmed: (n,) setpoint of the programmed path, which corrections do not move; None if not sent.
            When it changes, a new RSI session has begun. While it is written the same, it is the same object.
        is_usual: whether the telegram has the layout of `usual_telegram`.
    """

    ipoc: int
    q: Array | None
    delay: int | None
    inputs: dict[str, bool]
    q_programmed: Array | None
    is_usual: bool = False


class SensorCodec:
    """Codec of one robot's telegrams at the PC's end.

    Args:
        config: the controller's `*_ethernet.xml`.
        axes: the robot's joints.
        inputs: per name of a digital input the TAG of its BOOL of SEND.
        outputs: per name of a digital output the TAG of its BOOL of RECEIVE.
        stop: TAG of the BOOL of RECEIVE that ends the motion on the controller's side; None if it has none.

    Attributes:
        axes: as given.
        has_programmed: whether the controller sends its programmed position.

    Raises:
        EthernetConfigError: if the configuration has no measured position or no correction of some joint, or
            lacks a digital signal.
    """

    def __init__(
        self,
        config: EthernetConfig,
        axes: AxisMap,
        inputs: Mapping[str, str] = MappingProxyType({}),
        outputs: Mapping[str, str] = MappingProxyType({}),
        stop: str | None = None,
    ) -> None:
        self._config = config
        self.axes = axes
        self._fields = send_fields(config)
        self._compile_decoder(inputs)
        self._compile_encoder(outputs, stop)

    @property
    def joints(self) -> int:
        """Number of joints, the length of every vector taken or returned."""
        return len(self.axes.joints)

    @property
    def template(self) -> tuple[bytes, tuple[int, ...]]:
        """A reply as a template, and the value for each of its places.

        A place is an index into corrections [deg or mm], then outputs, then IPOC and stop.
        """
        return self._template, tuple(self._places)

    def _compile_decoder(self, inputs: Mapping[str, str]) -> None:
        by_name = {
            (field.group, field.attribute): field
            for field in self._fields
            if field.element.internal is not None
        }
        measured, programmed = (
            [by_name.get((arm if axis[0] == "A" else external, axis)) for axis in self.axes.axes]
            for arm, external in (("AIPos", "EIPos"), ("ASPos", "ESPos"))
        )
        for axis, place in zip(self.axes.axes, measured, strict=True):
            if place is None:
                tag = "DEF_AIPos" if axis[0] == "A" else "DEF_EIPos"
                raise EthernetConfigError(
                    f"{self._config.source}: SEND does not have {tag}, which reports joint {axis.lower()}; "
                    "add it with TYPE DOUBLE and INDX INTERNAL"
                )
        digital = digital_fields(self._config, "SEND", self._fields, inputs)
        delay = by_name.get(("Delay", "D"))
        wanted = {field for field in [*measured, *programmed, *digital.values(), delay] if field}
        captured = [field for field in self._fields if field in wanted]
        place_of = {field: number for number, field in enumerate(captured)}

        def places(fields: list[Field | None]) -> list[int] | None:
            found = [place_of[field] for field in fields if field is not None]
            return found if len(found) == len(fields) else None

        self._q_places = places(measured) or []
        self._programmed_places = places(programmed)
        self._delay_place = None if delay is None else place_of[delay]
        self._input_places = {name: place_of[field] for name, field in digital.items()}
        self.has_programmed = self._programmed_places is not None
        self._per_reported = 1.0 / self.axes.reported
        self._last_programmed: tuple[list[bytes], Array] | None = None

        def value(field: Field) -> str:
            return f"({NUMBER})" if field in wanted else '[^"<]*'

        self._pattern = self._compile(document("Rob", _TYPE, self._fields, value, r"\s*"))
        self._usual = re.compile(usual_telegram(self._config, wanted)[0].encode())
        self._ipoc_only = self._compile(document("Rob", _TYPE, (), value, r"\s*"))

    @staticmethod
    def _compile(pattern: str) -> re.Pattern[bytes]:
        pattern = pattern.replace("%IPOC%", "([0-9]{1,20})")
        return re.compile(rb"\s*" + pattern.encode() + rb"\s*")

    def _compile_encoder(self, outputs: Mapping[str, str], stop: str | None) -> None:
        fields = receive_fields(self._config)
        signals = dict(outputs) if stop is None else {**outputs, _STOP: stop}
        axis_of = {field: axis for axis, field in correction_fields(self._config, self.axes).items()}
        output_of = {
            field: name for name, field in digital_fields(self._config, "RECEIVE", fields, signals).items()
        }
        joints = len(self.axes)
        self._outputs, self._known_outputs = tuple(outputs), frozenset(outputs)
        # the template's places, as indices into corrections, then outputs, then IPOC, then stop
        self._places: list[int] = []

        def value(field: Field) -> str:
            if (axis := axis_of.get(field)) in self.axes.axes:
                self._places.append(self.axes.axes.index(axis))
                return f"%.{DECIMALS}f"
            if (name := output_of.get(field)) == _STOP:
                self._places.append(joints + len(outputs) + 1)
                return "%d"
            if name is not None:
                self._places.append(joints + self._outputs.index(name))
                return "%d"
            if field.element.type is ElementType.DOUBLE:
                return f"{0:.{DECIMALS}f}"
            return "" if field.element.type is ElementType.STRING else "0"

        text = document("Sen", f'Type="{self._config.sentype}"', fields, value)
        self._places.append(joints + len(outputs))
        self._in_places = itemgetter(*self._places)
        self._all_off = (False,) * len(outputs)
        self._template = text.replace("%IPOC%", "%d").encode()

    def decode(self, datagram: bytes) -> KrcTelegram:
        """Read a telegram of the controller.

        Raises:
            TelegramError: if it is not a telegram; the message says which part is missing or damaged.
        """
        if len(datagram) > MAX_TELEGRAM_BYTES:
            return self._decode_ipoc_only(datagram)
        usual = self._usual.fullmatch(datagram)
        match = usual or self._pattern.fullmatch(datagram)
        if match is None:
            return self._decode_ipoc_only(datagram)
        values = match.groups()
        q = np.array([float(values[place]) for place in self._q_places]) * self._per_reported
        delay = None if self._delay_place is None else int(float(values[self._delay_place]))
        inputs = {name: float(values[place]) != 0.0 for name, place in self._input_places.items()}
        return KrcTelegram(int(values[-1]), q, delay, inputs, self._programmed(values), usual is not None)

    def _programmed(self, values: tuple[bytes, ...]) -> Array | None:
        if self._programmed_places is None:
            return None
        written = [values[place] for place in self._programmed_places]
        if self._last_programmed is None or self._last_programmed[0] != written:
            q_programmed = np.array([float(value) for value in written]) * self._per_reported
            self._last_programmed = written, q_programmed
        return self._last_programmed[1]

    def _decode_ipoc_only(self, datagram: bytes) -> KrcTelegram:
        if len(datagram) <= MAX_TELEGRAM_BYTES and (match := self._ipoc_only.fullmatch(datagram)):
            return KrcTelegram(int(match[1]), None, None, {}, None)
        raise TelegramError(f"{self._explain(datagram)}; got {len(datagram)} bytes: {datagram[:120]!r}")

    def _explain(self, datagram: bytes) -> str:
        if len(datagram) > MAX_TELEGRAM_BYTES:
            return f"a telegram has at most {MAX_TELEGRAM_BYTES} bytes"
        if not re.match(rb"\s*<Rob " + _TYPE.encode() + rb">", datagram):
            return 'a telegram of the controller starts with <Rob Type="KUKA">'
        for field in self._fields:
            if field.attribute is None:
                pattern = f"<{field.group}>[^<]*</{field.group}>"
            else:
                content = '[^"<]*' if field.element.type is ElementType.STRING else NUMBER
                pattern = f'<{field.group} (?:[^<>]* )?{field.attribute}="{content}"'
            if not re.search(pattern.encode(), datagram):
                name = field.group if field.attribute is None else f"{field.attribute} of {field.group}"
                return f"{name} is missing or no number, though {self._config.source} lists it in SEND"
        if not re.search(rb"<IPOC>[0-9]{1,20}</IPOC>\s*</", datagram):
            return "IPOC is missing, not last or no number"
        return (
            f"there is something in the telegram that {self._config.source} does not list in SEND, or its "
            "order is not the order of that file; load the same file on both sides"
        )

    def encode(
        self,
        ipoc: int,
        correction: Array,
        outputs: Mapping[str, bool] | None = None,
        stop: bool = False,
    ) -> bytes:
        """Write the reply to the telegram with that IPOC.

        Args:
            ipoc: that of the answered telegram.
            correction: (n,) total (absolute) or this cycle's (relative) correction [rad or m].
            outputs: digital outputs by name; those not given are off.
            stop: end the motion on the controller's side, if the codec has a TAG for it.

        Raises:
            TelegramError: if the correction has not n elements, or one that is not finite or too large to be
                written, or an output has a name that the robot does not have.
        """
        axes = self.axes.axes
        if len(correction) != len(axes):
            raise TelegramError(f"a correction has {len(axes)} elements, got {len(correction)}")
        values: list[float] = (correction * self.axes.commanded).tolist()
        for place, number in enumerate(values):
            if not -_MAX_CORRECTION < number < _MAX_CORRECTION:
                axis = axes[place]
                raise TelegramError(
                    f"correction of {axis} is {number} deg or mm, allowed is a finite number below "
                    f"{_MAX_CORRECTION:g}"
                )
        if outputs and not self._known_outputs.issuperset(outputs):
            raise TelegramError(
                f"outputs {sorted(set(outputs) - set(self._outputs))} are not known, allowed are "
                f"{list(self._outputs)}"
            )
        pool: list[object] = [
            *values,
            *([bool(outputs.get(name)) for name in self._outputs] if outputs else self._all_off),
            ipoc,
            stop,
        ]
        reply: bytes = self._template % self._in_places(pool)
        return reply
