"""A reply that is ready before its telegram comes, and what that telegram has to say for it.

Between a telegram and such a reply there are bytes and a few comparisons. A telegram that says anything else than what
was expected has no prepared reply: it is read, judged and answered as if nothing had been prepared.
"""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_protocol.rsi.usual_telegram import Texts, UsualTelegrams


@dataclass(frozen=True, slots=True, eq=False)
class PreparedReply:
    """One reply, for one IPOC.

    Attributes:
        telegrams: reads them.
        steady: what the telegram has to say besides its joints, see `UsualTelegrams`.
        lower, upper: (n,) where its joints have to be, in the controller's units; wherever in there they are, the reply
            is this one.
        correction: (n,) of the reply [rad or m].
        reply: the bytes.
    """

    telegrams: UsualTelegrams
    steady: Texts
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    correction: tuple[float, ...]
    reply: bytes

    def is_for(self, datagram: bytes) -> bool:
        """Whether a datagram of the KRC is the telegram that was expected."""
        read = self.telegrams.read(datagram)
        if read is None:
            return False
        for text, lower, upper in zip(read[0], self.lower, self.upper, strict=True):
            if not lower <= float(text) <= upper:
                return False
        return read[1] == self.steady
