"""Answers to a KRC that correct nothing, for first contact.

An absolute correction of zero means "back to where RSI was started": harmless at the start, and a jump for a robot that
has been corrected already. So a robot that stands away from its start is not answered at all.
"""

from __future__ import annotations

import numpy as np

from deltaq_protocol.rsi import KrcTelegram, SensorCodec, TelegramError
from deltaq_protocol.rsi.layout import MAX_IPOC

AWAY = 2e-3
"""Distance from the start that rounding to one decimal, and a drive at rest, leave [rad or m]."""


MOST_REASONS = 16


class ZeroEcho:
    """Decides on the answer to each telegram; it has no way to send anything but zeros, digital outputs included.

    Attributes:
        refusals: telegrams that got no answer, by reason.
    """

    def __init__(self, codec: SensorCodec) -> None:
        self._codec = codec
        self._zeros = np.zeros(codec.joints)
        self._peer: str | None = None
        self.refusals: dict[str, int] = {}

    def answer(self, datagram: bytes, peer: str) -> bytes | None:
        """The answer to a telegram, or None if it must not be answered."""
        try:
            telegram = self._codec.decode(datagram)
        except TelegramError as error:
            reason: str | None = f"no telegram of the cell's file: {str(error).partition('; got')[0]}"
        else:
            reason = self._objection(telegram, peer)
            if reason is None:
                return self._codec.encode(telegram.ipoc, self._zeros)
        if reason in self.refusals or len(self.refusals) < MOST_REASONS:
            self.refusals[str(reason)] = self.refusals.get(str(reason), 0) + 1
        return None

    def _objection(self, telegram: KrcTelegram, peer: str) -> str | None:
        self._peer = self._peer or peer
        if peer != self._peer:
            return f"{peer} is another sender than {self._peer}, which came first"
        if telegram.ipoc > MAX_IPOC:
            return f"IPOC has more than 32 bit, and a KRC's is at most {MAX_IPOC}"
        if telegram.q is None:  # the opening of a KR C2: the robot stands at its start
            return None
        if telegram.q_programmed is None:
            return "without DEF_ASPos in SEND nobody can tell whether the robot stands where RSI was started"
        away = np.abs(telegram.q - telegram.q_programmed)
        if (away > AWAY).any():
            axis = self._codec.axes.axes[int(np.argmax(away))]
            return (
                f"{axis} stands away from where RSI was started, and zero would let it jump back: end RSI and start it "
                "again"
            )
        return None
