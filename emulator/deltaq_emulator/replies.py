"""Judges replies: finds the one that answers this cycle's telegram, and names the fault of each other one."""

from collections import OrderedDict
from enum import StrEnum
from typing import Literal

from deltaq_emulator.settings import LateBudget
from deltaq_protocol.rsi import KrcCodec, SensorTelegram, TelegramError

HISTORY = 256
"""Number of past telegrams for which a reply is still recognised as late or duplicate."""
MAX_EXCUSED = 100
"""Cycles in a row for which a missing reply may be excused; a PC that is silent for longer is late."""
_RING = 2**32


class Reply(StrEnum):
    """Class of a datagram, or of a cycle without a valid one."""

    ACCEPTED = "accepted"
    LATE = "late"
    """Answers an earlier telegram, or this one after the time allowed."""
    STALE = "stale"
    """Answers a telegram too old to remember, or one that was never sent."""
    DUPLICATE = "duplicate"
    """Answers a telegram that was answered already."""
    FUTURE = "future"
    """Has a time stamp that was not sent yet."""
    GARBLED = "garbled"
    WRONG_TYPE = "wrong_type"
    MISSING = "missing"
    """No datagram came in a cycle."""
    UNANSWERED = "unanswered"
    """A cycle without a valid reply; the element Delay counts these."""
    EXCUSED = "excused"
    """Such a cycle in which the machine held up the controller itself: not the PC's fault."""


class ReplyJudge:
    """Counts every datagram by class and finds the one valid reply of each cycle.

    Args:
        codec: reads the datagrams.
        reply_within_s: age at which a reply no longer counts.
        budget: counts the cycles without one.
        count_from: whether to begin with the first reply of a session or its start.
    """

    def __init__(
        self,
        codec: KrcCodec,
        reply_within_s: float,
        budget: LateBudget,
        count_from: Literal["first_reply", "start"],
    ) -> None:
        self._codec = codec
        self._reply_within_s = reply_within_s
        self._budget = budget
        self._count_from = count_from
        self.counts: dict[str, int] = {reply.value: 0 for reply in Reply}
        """Datagrams and cycles by class, since the controller was switched on."""
        self.begin_session()

    def begin_session(self) -> None:
        """Forget the telegrams of the last session, and count late cycles from zero."""
        self._answered: OrderedDict[int, bool] = OrderedDict()
        self._current: int | None = None
        self._accepted: SensorTelegram | None = None
        self._anything_came = False
        self._excused = 0
        self._counting = self._count_from == "start"
        self._budget.begin_session()
        self.delay = 0
        """Cycles of this session without a valid reply."""

    @property
    def waiting(self) -> bool:
        """Whether a telegram of this session has been sent."""
        return self._current is not None

    def sent(self, ipoc: int) -> None:
        """Note that a telegram with this time stamp is sent."""
        self._current = ipoc
        self._answered[ipoc] = False
        while len(self._answered) > HISTORY:
            self._answered.popitem(last=False)

    def judge(self, datagram: bytes, age_s: float) -> Reply:
        """Classify and count a datagram that arrived `age_s` after this cycle's telegram."""
        self._anything_came = True
        try:
            telegram = self._codec.decode(datagram)
        except TelegramError:
            verdict = Reply.GARBLED
        else:
            verdict = self._classify(telegram, age_s)
            if verdict is Reply.ACCEPTED:
                self._accepted = telegram
        self.counts[verdict] += 1
        return verdict

    def _classify(self, telegram: SensorTelegram, age_s: float) -> Reply:
        if telegram.type != self._codec.config.sentype:
            return Reply.WRONG_TYPE
        if self._current is None:
            return Reply.STALE
        ahead = (telegram.ipoc - self._current + _RING // 2) % _RING - _RING // 2
        if ahead > 0:
            return Reply.FUTURE
        if telegram.ipoc not in self._answered:
            return Reply.STALE
        if self._answered[telegram.ipoc]:
            return Reply.DUPLICATE
        self._answered[telegram.ipoc] = True
        if ahead < 0 or age_s > self._reply_within_s:
            return Reply.LATE
        return Reply.ACCEPTED

    def close_cycle(self, excused: bool = False) -> SensorTelegram | None:
        """End a cycle: its valid reply, or None, which counts as late.

        Args:
            excused: the controller itself was held up, so that a missing reply is not the PC's fault: it counts in
                the element Delay and not against the budget, `MAX_EXCUSED` times in a row.
        """
        reply, self._accepted = self._accepted, None
        came, self._anything_came = self._anything_came, False
        if reply is not None:
            self._counting = True
            self._excused = 0
        else:
            self.counts[Reply.UNANSWERED] += 1
            self.counts[Reply.MISSING] += not came
            self.delay += 1
            if excused and self._excused < MAX_EXCUSED:
                self.counts[Reply.EXCUSED] += 1
                self._excused += 1
                return None
        if self._counting:
            self._budget.cycle(late=reply is None)
        return reply
