"""The record that a Robot Server writes to shared memory before each reply: the motion to send if the process dies.

There are two places, written in turn. If a kill tears the record being written, its checksum is wrong, and the one
before it is used. Behind them stands the number of the record whose reply was handed to the network.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import NamedTuple

PeerAddress = tuple[str, int]
"""Host, as four numbers with dots, and port."""

_SUM = struct.Struct("=I")
_HEAD = struct.Struct("=Q4sH")
_CYCLE = struct.Struct("=IIqIII")
_TIME = struct.Struct("=d")
SENT = struct.Struct("@Q")
"""Number of the record whose reply was sent last."""
NOTHING = 0
"""No record has this number."""


@dataclass(frozen=True, slots=True)
class CrashRecord:
    """One reply, and the brake that follows it.

    Attributes:
        ipoc, late, programmed: of the telegram that it answers, see `PlainTelegram`.
        ipoc_step: growth of the IPOC in a cycle.
        outputs: digital outputs, in the order of the cell.
        correction: (n,) of the reply [rad or m].
        plan_dq: (n,) increment that was admitted last [rad or m].
        brake_cycles: length of the brake that follows it.
        step: of that brake, as in the reply.
        lower, upper: (n,) bounds of a correction in this session [rad or m].
    """

    ipoc: int
    late: int
    programmed: int
    ipoc_step: int
    outputs: tuple[bool, ...]
    correction: tuple[float, ...]
    plan_dq: tuple[float, ...]
    brake_cycles: int
    step: int
    lower: tuple[float, ...]
    upper: tuple[float, ...]

    @property
    def rests(self) -> bool:
        """Whether the robot is at rest."""
        return self.step >= self.brake_cycles


class LastReply(NamedTuple):
    """The last reply of a dead Robot Server, and whether it was sent.

    Attributes:
        record: of its last reply.
        peer: address of the KRC that was answered.
        time_s: when its telegram came, on the monotonic clock.
        was_sent: whether the reply is known to have been handed to the network; it may have been if not.
    """

    record: CrashRecord
    peer: PeerAddress
    time_s: float
    was_sent: bool


class CrashRecords:
    """The layout of one robot's records.

    Args:
        joints: number of joints.
        outputs: number of digital outputs.

    Attributes:
        size: bytes of a record.
        total: bytes of all that lies in memory.
    """

    def __init__(self, joints: int, outputs: int) -> None:
        self._joints, self._outputs = joints, outputs
        self._values = struct.Struct(f"={4 * joints}d{outputs}?")
        self._bytes = _SUM.size + _HEAD.size + _CYCLE.size + self._values.size + _TIME.size
        self.size = -(-self._bytes // SENT.size) * SENT.size
        self.sent_at = 2 * self.size
        self.total = self.sent_at + SENT.size

    def body(self, record: CrashRecord) -> bytes:
        """A record without its header and checksum."""
        cycle = _CYCLE.pack(
            record.ipoc,
            record.ipoc_step,
            record.late,
            record.programmed,
            record.brake_cycles,
            record.step,
        )
        values = (*record.correction, *record.plan_dq, *record.lower, *record.upper, *record.outputs)
        return cycle + self._values.pack(*values)

    def sealed(self, body: bytes, number: int, peer: PeerAddress, time_s: float) -> tuple[int, bytes]:
        """Where a record belongs, and all its bytes.

        Args:
            body: of the record.
            number: one more than that of the record before.
            peer: address of the KRC that is answered.
            time_s: when its telegram came.
        """
        host, port = peer
        begins = _HEAD.pack(number, bytes(map(int, host.split("."))), port) + body + _TIME.pack(time_s)
        return (number & 1) * self.size, _SUM.pack(zlib.crc32(begins)) + begins

    def newest(self, memory: bytes) -> LastReply | None:
        """The newest complete record; None if there is no valid one.

        A record is of no use if a later reply was sent already: the KRC's position is then unknown.
        """
        (sent,) = SENT.unpack_from(memory, self.sent_at)
        whole = [
            found for place in (0, self.size) if (found := self._unsealed(memory[place:][: self._bytes]))
        ]
        if not whole:
            return None
        number, record, peer, time_s = max(whole, key=lambda each: each[0])
        return None if sent > number else LastReply(record, peer, time_s, sent == number)

    def _unsealed(self, sealed: bytes) -> tuple[int, CrashRecord, PeerAddress, float] | None:
        (checksum,) = _SUM.unpack_from(sealed)
        if zlib.crc32(sealed[_SUM.size :]) != checksum:
            return None
        number, host, port = _HEAD.unpack_from(sealed, _SUM.size)
        (time_s,) = _TIME.unpack_from(sealed, self._bytes - _TIME.size)
        if number == NOTHING:
            return None
        begins = _SUM.size + _HEAD.size
        ipoc, ipoc_step, late, programmed, brake_cycles, step = _CYCLE.unpack_from(sealed, begins)
        values = self._values.unpack_from(sealed, begins + _CYCLE.size)
        n = self._joints
        correction, plan_dq, lower, upper = (values[k * n : (k + 1) * n] for k in range(4))
        outputs = values[4 * n :]
        record = CrashRecord(
            ipoc,
            late,
            programmed,
            ipoc_step,
            outputs,
            correction,
            plan_dq,
            brake_cycles,
            step,
            lower,
            upper,
        )
        return number, record, (".".join(map(str, host)), port), time_s
