"""A reply that is ready before its telegram comes, and what that telegram has to be.

Between a telegram and such a reply there are bytes and a few comparisons. A telegram that says anything else than what
was expected has no prepared reply: it is read, judged and answered as if nothing had been prepared.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # loads numba, which takes long, and which only those need who prepare replies
    from deltaq_services.robot_server.expected_telegram import ExpectedTelegram


class TelegramOutcome(IntEnum):
    """How a wait for the telegram ended."""

    NOTHING = 0
    """Its time was over, or a signal came."""
    ERROR = 1
    """The socket had an error: an earlier reply found nobody there."""
    OTHER = 2
    """A datagram that has no prepared reply."""
    ANSWERED = 3
    """The telegram that was expected, from its sender, and nothing behind it; its reply was sent."""
    UNSENT = 4
    """The same, but the network did not take the reply."""
    NEWS = 5
    """No datagram, but the gate has said something."""

    @property
    def is_answer(self) -> bool:
        """Whether the telegram was answered, as far as that lies with this process."""
        return self in (TelegramOutcome.ANSWERED, TelegramOutcome.UNSENT)


@dataclass(frozen=True, slots=True, eq=False)
class PreparedReply:
    """One reply, for one IPOC.

    Attributes:
        telegram: that it answers, see `expected_telegram`. Wherever its joints are within their bounds, the reply is
            this one.
        correction: (n,) of the reply [rad or m].
        reply: the bytes.
        record: what to leave before it is sent, see `CrashRecordMaker`.
    """

    telegram: ExpectedTelegram
    correction: tuple[float, ...]
    reply: bytes
    record: bytes | None = None
