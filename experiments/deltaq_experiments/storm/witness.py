"""Whether each correction that went over RSI's wire is explained: by an admission, its brake, or by not moving.

The witness reads telegrams and replies off the wire, and admissions off the gate's topic; it asks the Robot Server
nothing.
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from deltaq_protocol.brake import brake_increment
from deltaq_protocol.guarded import Admission
from deltaq_protocol.rsi import KrcCodec, SensorCodec, TelegramError

Array = NDArray[np.float64]
Origin = tuple[float, ...]
"""Programmed position of a session of the KRC's program [rad or m]."""

ROUNDING = 2e-8
"""What six decimals of a degree may add to a difference of two corrections [rad or m]."""
_REMEMBERED = 4096
_IN_FLIGHT = 2000
"""Admissions after the last one taken among which the next is looked for: those not taken were late or refused."""


class UnexplainedError(Exception):
    """A correction changed, and nothing explains it."""


class Kind(Enum):
    """Whose datagram it is."""

    TELEGRAM = 0
    """Of the KRC itself."""
    FORGERY = 1
    """Of an attacker."""
    REPLY = 2


@dataclass(frozen=True)
class Passed:
    """A datagram that passed, and when [ns]."""

    kind: Kind
    datagram: bytes
    stamp_ns: int


class Witness:
    """Judges what passed, in its order.

    Args:
        of_krc: reads telegrams; of_server: reads replies.

    Attributes:
        counts: replies by what explains them, telegrams, and sessions of the KRC.
    """

    def __init__(self, of_krc: SensorCodec, of_server: KrcCodec) -> None:
        self.counts: Counter[str] = Counter()
        self._of_krc, self._of_server = of_krc, of_server
        self._programmed: OrderedDict[int, Origin] = OrderedDict()
        self._origins: set[Origin] = set()
        self._origin: Origin | None = None
        self._correction = np.zeros(of_krc.joints)
        self._course: list[Array] = []
        self._taken = -1

    def judge(self, passed: Sequence[Passed], admissions: Sequence[Admission]) -> None:
        """Judge a whole run, in the order of its stamps; admissions are those of one gate, in any order.

        Raises:
            UnexplainedError: at the first correction that is not explained.
        """
        ordered = sorted(admissions, key=lambda admission: admission.sequence)
        self._sequences = [admission.sequence for admission in ordered]
        self._follows = np.array([admission.follows_q_cmd for admission in ordered])
        self._dq = np.array([admission.dq for admission in ordered])
        self._brake_cycles = [admission.brake_cycles for admission in ordered]
        for one in sorted(passed, key=lambda one: one.stamp_ns):
            match one.kind:
                case Kind.REPLY:
                    self._reply(one.datagram)
                case Kind.TELEGRAM:
                    self._telegram(one.datagram)
                case Kind.FORGERY:
                    self._forgery(one.datagram)

    def _telegram(self, datagram: bytes) -> None:
        try:
            telegram = self._of_krc.decode(datagram)
        except TelegramError as error:
            raise UnexplainedError(f"the KRC's own telegram cannot be read: {error}") from error
        self.counts["telegrams"] += 1
        if telegram.q_programmed is not None:
            origin = tuple(telegram.q_programmed.tolist())
            self._origins.add(origin)
            self._remember(telegram.ipoc, origin)

    def _forgery(self, datagram: bytes) -> None:
        """What is forged may be answered, in the session whose programmed position it repeats."""
        try:
            telegram = self._of_krc.decode(datagram)
        except TelegramError:
            return
        if telegram.q_programmed is not None and telegram.ipoc not in self._programmed:
            origin = tuple(telegram.q_programmed.tolist())
            if origin in self._origins:
                self._remember(telegram.ipoc, origin)

    def _remember(self, ipoc: int, origin: Origin) -> None:
        self._programmed[ipoc] = origin
        while len(self._programmed) > _REMEMBERED:
            self._programmed.popitem(last=False)

    def _reply(self, datagram: bytes) -> None:
        told = self._of_server.decode(datagram)
        self.counts["replies"] += 1
        origin = self._programmed.get(told.ipoc, self._origin)
        if origin != self._origin:
            # another session of the KRC's program, which begins without a correction
            self.counts["sessions"] += 1
            self._origin, self._correction, self._course = origin, np.zeros_like(told.correction), []
        moved = told.correction - self._correction
        setpoint = self._correction if origin is None else np.array(origin) + self._correction
        self._correction = told.correction
        if self._course and _near(moved, self._course[0]):
            self._course.pop(0)
            self.counts["by a brake"] += 1
        elif _near(moved, np.zeros_like(moved)):
            self.counts["unmoved"] += 1
        elif (taken := self._admission(setpoint, moved)) is not None:
            dq, n = self._dq[taken], self._brake_cycles[taken]
            self._course = [brake_increment(dq, n, step) for step in range(1, n)]
            self._taken = taken
            self.counts["by an admission"] += 1
        else:
            raise UnexplainedError(
                f"reply {self.counts['replies']} moved by {moved}; the brake's next is {self._course[:1]}"
            )

    def _admission(self, setpoint: Array, moved: Array) -> int | None:
        """The first admission not yet taken that follows this setpoint and moves so far."""
        first = self._taken + 1
        window = slice(first, first + _IN_FLIGHT)
        off = np.maximum(np.abs(self._follows[window] - setpoint), np.abs(self._dq[window] - moved))
        found = np.flatnonzero((off <= 2 * ROUNDING).all(axis=1)).tolist() if len(off) else []
        return first + found[0] if found else None


def _near(one: Array, other: Array) -> bool:
    return bool((np.abs(one - other) <= ROUNDING).all())
