"""RSI as the Robot Server speaks it: telegrams to measurements, setpoints to absolute corrections.

An absolute correction is an offset from where the programmed path stands, so rounding to the telegram's decimals
never accumulates. With `DEF_ASPos` in the telegram that place is known even if this process joins a session
that is under way; without it, the first measured position is taken for it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.rsi import KrcTelegram, SensorCodec
from deltaq_services.robot_server.core import Measurement

Array = NDArray[np.float64]

_IPOC_WRAP = 2**32
_LARGEST_GAP_CYCLES = 100
"""An IPOC that leaps further than this belongs to a new session."""

_STILL = 1e-5
"""Change of a measured joint between telegrams that counts as standing still [rad or m]."""


class RsiDriver:
    """One RSI channel.

    Args:
        codec: telegrams of the robot.
        cycle_s: sample time; the IPOC counts milliseconds.

    Attributes:
        ipoc: stamp of the telegram read last.
        opening_reply: answer to a telegram that opens a session and reports no joints, as a KR C2 sends it.
    """

    def __init__(self, codec: SensorCodec, cycle_s: float) -> None:
        self._codec = codec
        self._cycle_ms = round(cycle_s * 1000)
        self._last: KrcTelegram | None = None
        self._origin: Array | None = None
        self._no_correction = np.zeros(codec.joints)
        self._overtaken: int | None = None
        self.ipoc = 0
        self.opening_reply: bytes | None = None

    def read(self, datagram: bytes) -> Measurement | None:
        """Read a telegram.

        Returns:
            What it measures; None if it must not be answered with a setpoint: it came twice or was overtaken, it
            reports no joints (the first telegram of a KR C2), or a session was joined with the robot moving.

        Raises:
            TelegramError: if it is no telegram of this robot.
        """
        telegram = self._codec.decode(datagram)
        self.opening_reply = None
        if self._out_of_turn(telegram):
            return None
        last, self._last, self.ipoc = self._last, telegram, telegram.ipoc
        if telegram.q is None:
            self._origin = None
            self.opening_reply = self._codec.encode(telegram.ipoc, self._no_correction)
            return None
        begins = self._origin is None or self._new_session(last, telegram)
        if begins:
            self._origin = None
            origin = telegram.q if telegram.q_programmed is None else telegram.q_programmed
            corrected = bool(np.any(np.abs(telegram.q - origin) > _STILL))
            still = (
                last is not None and last.q is not None and bool(np.all(np.abs(telegram.q - last.q) < _STILL))
            )
            if corrected and not still:
                return None
            self._origin = origin
        missed = (
            not begins
            and last is not None
            and telegram.delay is not None
            and telegram.delay > (last.delay or 0)
        )
        return Measurement(
            ipoc=telegram.ipoc,
            q=telegram.q,
            q_start=telegram.q if begins else None,
            missed_last=missed,
            inputs=telegram.inputs,
        )

    def reply(self, q_cmd: Array, outputs: dict[str, bool]) -> bytes:
        """The answer to the telegram read last, with the setpoint (n,) [rad or m]."""
        assert self._origin is not None  # there is no setpoint without a measurement
        return self._codec.encode(self.ipoc, q_cmd - self._origin, outputs)

    def _out_of_turn(self, telegram: KrcTelegram) -> bool:
        """Whether the wire delivered a telegram twice or late; two that follow each other are a clock set back."""
        if self._last is None or self._origin is None:
            return False
        behind = (self._last.ipoc - telegram.ipoc) % _IPOC_WRAP
        if behind % self._cycle_ms or behind > _LARGEST_GAP_CYCLES * self._cycle_ms:
            return False
        follows = self._overtaken == (telegram.ipoc - self._cycle_ms) % _IPOC_WRAP
        self._overtaken = telegram.ipoc
        return behind == 0 or not follows

    def _new_session(self, last: KrcTelegram | None, telegram: KrcTelegram) -> bool:
        if last is None or last.q is None:
            return True
        step = (telegram.ipoc - last.ipoc) % _IPOC_WRAP
        if step % self._cycle_ms or not 0 < step <= _LARGEST_GAP_CYCLES * self._cycle_ms:
            return True
        if telegram.q_programmed is None or last.q_programmed is None:
            return False
        return bool(np.any(np.abs(telegram.q_programmed - last.q_programmed) > _STILL))
