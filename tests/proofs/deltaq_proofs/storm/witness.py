"""Whether each correction that went over RSI's wire is explained: by an admission, its brake, a probe, or not moving.

The witness reads telegrams and replies off the wire, and admissions off the gate's topics; it asks the Robot Server
nothing. An admission that was lost on its way to the witness explains no more than an admission could do, and is
counted apart.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from deltaq_proofs.storm.admitted import ROUNDING, Admitted
from deltaq_proofs.storm.pulses import Pulses
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import KrcCodec, SensorCodec, TelegramError

Origin = tuple[float, ...]
"""Programmed position of a session of the KRC's program [rad or m]."""

UNHEARD = "by an admission that was not heard"
_REMEMBERED = 4096
_TOLD = 24
"""Replies before the unexplained one that are told with it."""


class UnexplainedError(Exception):
    """A correction changed, and nothing explains it."""


class DatagramOrigin(Enum):
    """Whose datagram it is."""

    TELEGRAM = 0
    """Of the KRC itself."""
    FORGERY = 1
    """Of an attacker."""
    REPLY = 2


@dataclass(frozen=True)
class Passed:
    """A datagram that passed, and when [ns]."""

    kind: DatagramOrigin
    datagram: bytes
    stamp_ns: int


class Witness:
    """Judges what passed, in its order.

    Args:
        of_krc: reads telegrams; of_server: reads replies.
        pulses: (k, n) of the probe of a session's mode, see `pulse_offsets` [rad or m].

    Attributes:
        counts: replies by what explains them, telegrams, and sessions of the KRC.
    """

    def __init__(self, of_krc: SensorCodec, of_server: KrcCodec, pulses: Array) -> None:
        self.counts: Counter[str] = Counter()
        self._of_krc, self._of_server = of_krc, of_server
        self._pulses = Pulses(pulses, 2 * ROUNDING)
        self._programmed: OrderedDict[int, tuple[Origin, ...]] = OrderedDict()
        self._origins: set[Origin] = set()
        self._origin: Origin | None = None
        self._correction = np.zeros(of_krc.joints)
        self._moved = np.zeros(of_krc.joints)
        self._course: list[Array] = []
        self._last: deque[str] = deque(maxlen=_TOLD)

    def judge(self, passed: Sequence[Passed], admitted: Admitted) -> None:
        """Judge a whole run, in the order of its stamps.

        Raises:
            UnexplainedError: at the first correction that is not explained.
        """
        for one in sorted(passed, key=lambda one: one.stamp_ns):
            match one.kind:
                case DatagramOrigin.REPLY:
                    before = self.counts.copy()
                    self._reply(one.datagram, admitted)
                    self._note(self.counts - before)
                case DatagramOrigin.TELEGRAM:
                    self._telegram(one.datagram)
                case DatagramOrigin.FORGERY:
                    self._forgery(one.datagram)

    def _note(self, counted: Counter[str]) -> None:
        why = ", ".join(name for name in counted if name != "replies")
        self._last.append(f"{self.counts['replies']}: {self._correction.tolist()} {why}; {self._pulses}")

    def _telegram(self, datagram: bytes) -> None:
        try:
            telegram = self._of_krc.decode(datagram)
        except TelegramError as error:
            raise UnexplainedError(f"the KRC's own telegram cannot be read: {error}") from error
        self.counts["telegrams"] += 1
        if telegram.q_programmed is not None:
            origin = tuple(telegram.q_programmed.tolist())
            self._origins.add(origin)
            self._remember(telegram.ipoc, (origin,))

    def _forgery(self, datagram: bytes) -> None:
        """What is forged may be answered, in the session whose programmed position it repeats."""
        try:
            telegram = self._of_krc.decode(datagram)
        except TelegramError:
            return
        if telegram.q_programmed is not None:
            origin = tuple(telegram.q_programmed.tolist())
            known = self._programmed.get(telegram.ipoc, ())
            if origin in self._origins and origin not in known:
                self._remember(telegram.ipoc, (*known, origin))

    def _remember(self, ipoc: int, origins: tuple[Origin, ...]) -> None:
        self._programmed[ipoc] = origins
        while len(self._programmed) > _REMEMBERED:
            self._programmed.popitem(last=False)

    def _reply(self, datagram: bytes, admitted: Admitted) -> None:
        reply = self._of_server.decode(datagram)
        self.counts["replies"] += 1
        origin = self._answered_in(reply.ipoc)
        if origin != self._origin:
            # another session of the KRC's program, which begins without a correction
            self.counts["sessions"] += 1
            self._origin, self._correction, self._course = origin, np.zeros_like(reply.correction), []
            if self._pulses.begin(reply.correction):
                self._correction = reply.correction
                self.counts["by a probe"] += 1
                return
        moved = reply.correction - self._correction
        setpoint = self._correction if origin is None else np.array(origin) + self._correction
        self._correction = reply.correction
        if not self._is_at_rest(moved):
            self._step(setpoint, moved, admitted)

    def _answered_in(self, ipoc: int) -> Origin | None:
        """The session of the telegram that is answered: the present one, unless no telegram of that IPOC was of it."""
        origins = self._programmed.get(ipoc, ())
        return self._origin if self._origin in origins or not origins else origins[-1]

    def _is_at_rest(self, moved: Array) -> bool:
        if not (np.abs(moved) <= ROUNDING).all() or (self._course and _near(moved, self._course[0])):
            return False
        self.counts["unmoved"] += 1
        if not self._course:
            self._moved = np.zeros_like(
                moved
            )  # a brake that is not over may go on after a reply that was missed
        return True

    def _step(self, setpoint: Array, moved: Array, admitted: Admitted) -> None:
        if self._course and _near(moved, self._course[0]):
            self._course.pop(0)
            self.counts["by a brake"] += 1
        elif (brake := admitted.take(setpoint, moved)) is not None:
            self._course = brake
            self.counts["by an admission"] += 1
        elif self._pulses.explains(moved):
            self._course = []
            self.counts["by a probe"] += 1
        elif (brake := admitted.take_unheard(self._moved, moved)) is not None:
            self._course = brake
            self.counts[UNHEARD] += 1
        else:
            raise UnexplainedError(
                f"reply {self.counts['replies']} moved by {moved} after {self._moved}; the brake's next is "
                f"{self._course[:1]}; {self._pulses}. The replies before, as number: correction why\n"
                + "\n".join(self._last)
            )
        self._moved = moved


def _near(one: Array, other: Array) -> bool:
    """Whether two steps are the same; each may be a difference of rounded corrections."""
    return bool((np.abs(one - other) <= 2 * ROUNDING).all())
