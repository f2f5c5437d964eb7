"""A reply that is ready before its telegram comes, and what that telegram has to say for it.

Between a telegram and such a reply there are bytes and a few comparisons. A telegram that says anything else than what
was expected has no prepared reply: it is read, judged and answered as if nothing had been prepared.
"""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_protocol.rsi.usual_telegram import UsualTelegrams


@dataclass(frozen=True, slots=True, eq=False)
class PreparedReply:
    """One reply, for one IPOC.

    Attributes:
        telegrams: reads them.
        steady: elements that the telegram has to repeat of the one before it, see `UsualTelegrams`.
        end: how it has to end: with the expected IPOC.
        lower, upper: (n,) where its joints have to be, in its own order and units; wherever in there they are, the
            reply is this one.
        correction: (n,) of the reply [rad or m].
        reply: the bytes.
        record: what to leave before it is sent, see `CrashRecordMaker`.
    """

    telegrams: UsualTelegrams
    steady: tuple[bytes, ...]
    end: bytes
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    correction: tuple[float, ...]
    reply: bytes
    record: bytes | None = None

    def is_for(self, datagram: bytes) -> bool:
        """Whether a datagram of the KRC is the telegram that was expected."""
        joints = self.telegrams.joints(datagram)
        if joints is None:
            return False
        for text, lower, upper in zip(joints, self.lower, self.upper, strict=True):
            if not lower <= float(text) <= upper:
                return False
        for element in self.steady:
            if element not in datagram:
                return False
        return datagram.endswith(self.end)
