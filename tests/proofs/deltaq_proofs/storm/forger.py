"""What an attacker on RSI's wire sends: made from the true telegrams that it overhears, or from nothing."""

import random
import re
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from enum import StrEnum
from types import TracebackType
from typing import NamedTuple, Self

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.codec import unpack
from deltaq_protocol.envelope import message_in
from deltaq_protocol.guarded import Admission, GateEntry, ServerState
from deltaq_protocol.sayings import SIM, robot_server
from deltaq_protocol.session import subscribe_newest
from deltaq_services.guarded_realm import guarded_links, open_watching_session

_IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
_IPOCS = 2**32
_OVERHEARD = 20
_STEP = 12
"""What the attacker lets a clock of its own grow by."""
_ROOM = 60_000
"""Bytes of an oversized datagram, at most."""


class ForgedSender(StrEnum):
    """Whose address a datagram carries."""

    KRC = "the KRC"
    SECOND_KRC = "a second KRC"
    STRANGER = "a stranger"


class ForgedDatagram(NamedTuple):
    """One datagram of the attacker."""

    kind: str
    sender: ForgedSender
    datagram: bytes


class Forger:
    """Makes forgeries, as a seed decides; most of them come from elsewhere or cannot be read.

    Those that can, and seem to be the KRC's own, are rare: each of them costs the KRC an answer, and one without
    answers stops by itself.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self._overheard: deque[bytes] = deque(maxlen=_OVERHEARD)
        self._ipoc = self._random.randrange(_IPOCS)
        make: dict[str, tuple[float, ForgedSender, Callable[[], bytes]]] = {
            "copy from elsewhere": (150, ForgedSender.STRANGER, self._own),
            "next from elsewhere": (100, ForgedSender.STRANGER, self._next_moved),
            "copy of a second KRC": (100, ForgedSender.SECOND_KRC, self._own),
            "session of a second KRC": (250, ForgedSender.SECOND_KRC, self._session),
            "noise": (50, ForgedSender.STRANGER, self._noise),
            "own noise": (50, ForgedSender.KRC, self._noise),
            "truncated": (120, ForgedSender.KRC, self._truncated),
            "garbled": (120, ForgedSender.KRC, self._garbled),
            "duplicate": (10, ForgedSender.KRC, self._own),
            "overtaken": (8, ForgedSender.KRC, self._older),
            "oversized": (40, ForgedSender.KRC, self._oversized),
            "empty": (10, ForgedSender.KRC, lambda: b""),
            "another digit": (2, ForgedSender.KRC, lambda: self._other_digit(self._own())),
            "far": (1, ForgedSender.KRC, lambda: self._with_ipoc(self._own(), 12 * self._random.randrange(2, 10**6))),
            "back": (2, ForgedSender.KRC, lambda: self._with_ipoc(self._own(), -self._random.randrange(1, 5000))),
            "next": (0.5, ForgedSender.KRC, lambda: self._with_ipoc(self._own(), _STEP)),
            "next elsewhere": (0.5, ForgedSender.KRC, self._next_moved),
            "next with another digit": (1, ForgedSender.KRC, lambda: self._other_digit(self._next())),
            "session from elsewhere": (0.2, ForgedSender.KRC, self._session),
        }  # fmt: skip
        self._make = make
        self._kinds = list(make)
        self._weights = [weight for weight, _, _ in make.values()]

    def overhear(self, telegram: bytes) -> None:
        """A true telegram has passed."""
        self._overheard.append(telegram)

    def forge(self) -> ForgedDatagram | None:
        """The next datagram; None while nothing was overheard."""
        if not self._overheard:
            return None
        (kind,) = self._random.choices(self._kinds, self._weights)
        _, sender, make = self._make[kind]
        return ForgedDatagram(kind, sender, make())

    def chance(self, share: float) -> bool:
        """Whether something happens that happens to this share."""
        return self._random.random() < share

    def _own(self) -> bytes:
        return self._overheard[-1]

    def _older(self) -> bytes:
        return self._random.choice(self._overheard)

    def _next(self) -> bytes:
        return self._with_ipoc(self._own(), _STEP)

    def _next_moved(self) -> bytes:
        """The next cycle's, from a robot that seems to stand up to a few degrees away."""
        shift = self._random.gauss(0.0, 1.5)

        def moved(match: re.Match[bytes]) -> bytes:
            return b'%s"%.4f"' % (match[1], float(match[2]) + shift)

        head, axes, rest = self._next().partition(b"<AIPos")
        axis, _, tail = rest.partition(b"/>")
        return head + axes + re.sub(rb'( A\d=)"([^"]+)"', moved, axis) + b"/>" + tail

    def _session(self) -> bytes:
        """Of a clock of its own, standing still: each agrees with the one before."""
        self._ipoc = (self._ipoc + _STEP) % _IPOCS
        if self.chance(0.01):
            self._ipoc = self._random.randrange(_IPOCS)
        return _IPOC.sub(b"<IPOC>%d</IPOC>" % self._ipoc, self._overheard[0])

    def _truncated(self) -> bytes:
        own = self._own()
        return own[: self._random.randrange(len(own))]

    def _garbled(self) -> bytes:
        own = bytearray(self._next())
        for _ in range(self._random.randint(1, 4)):
            own[self._random.randrange(len(own))] = self._random.randrange(256)
        return bytes(own)

    def _other_digit(self, own: bytes) -> bytes:
        places = [place for place, byte in enumerate(own) if 0x30 <= byte <= 0x39]
        place = self._random.choice(places)
        return own[:place] + b"%d" % self._random.randrange(10) + own[place + 1 :]

    def _oversized(self) -> bytes:
        return self._own() + b" " * self._random.randrange(4096, _ROOM)

    def _noise(self) -> bytes:
        return self._random.randbytes(self._random.randrange(1, 1400))

    @staticmethod
    def _with_ipoc(own: bytes, ahead: int) -> bytes:
        return _IPOC.sub(lambda match: b"<IPOC>%d</IPOC>" % ((int(match[1]) + ahead) % _IPOCS), own)


_WAITING = 4096
"""Messages that may wait between two looks: more than ten seconds' of the gate's log."""


class Overheard:
    """Messages of the guarded realm; a context manager, whose `take` has to be called now and then.

    zenoh drops what a link cannot take at once. So each admission is read twice: as the Robot Server gets it, and from
    the gate's own log.

    Attributes:
        admissions: every one to any robot that was heard, by its sequence.
        counters: of the Robot Server, as its newest state has them.
    """

    def __init__(self, cell: CellDescription, robot: str) -> None:
        self.admissions: dict[int, Admission] = {}
        self.counters: dict[str, int] = {}
        self._session = open_watching_session(cell, SIM, [guarded_links(cell)[robot_server(robot)]])
        admission = topics.ADMISSION.key(cell.cell, robot="*")
        self._admissions = subscribe_newest(self._session, admission, _WAITING)
        self._log = subscribe_newest(self._session, topics.GATE_LOG.key(cell.cell), _WAITING)
        self._states = subscribe_newest(self._session, topics.SERVER_STATE.key(cell.cell, robot=robot))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._session.close()

    def take(self) -> None:
        """Take in what has come."""
        while (sample := self._admissions.try_recv()) is not None:
            self._heard(message_in(sample.payload.to_bytes()))
        while (sample := self._log.try_recv()) is not None:
            for name, data in unpack(GateEntry, sample.payload.to_bytes()).outputs:
                if name == topics.ADMISSION.name:
                    self._heard(data)
        sample = self._states.try_recv()
        if sample is not None:
            self.counters = unpack(ServerState, message_in(sample.payload.to_bytes())).counters

    def _heard(self, data: bytes) -> None:
        admission = unpack(Admission, data)
        self.admissions[admission.sequence] = admission


class Worker(ABC):
    """Works from the beginning of its block to the end; a context manager.

    Args:
        name: of the thread.

    Attributes:
        ended: set when the block is left.
    """

    def __init__(self, name: str) -> None:
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self.work, name=name)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @abstractmethod
    def work(self) -> None:
        """Work until `ended` is set; called in the thread."""

    def close(self) -> None:
        """End the work, and wait for its end."""
        self.ended.set()
        self._thread.join()
