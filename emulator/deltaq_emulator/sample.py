"""One cycle of the emulated robot, for recorders and judges."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deltaq_emulator.states import KrcState
from deltaq_protocol.arrays import Array


@dataclass(frozen=True)
class Sample:
    """One cycle of the emulated robot.

    Attributes:
        cycle: cycles since the controller was switched on.
        q: (n,) actual joints at the beginning of the cycle [rad or m].
        q_setpoint: (n,) setpoint of the drives during the cycle, corrections included [rad or m].
        message: the message on the pendant, if any.
        counters: datagrams and cycles by class, see `deltaq_emulator.replies.Reply`, and `clamped`, `sent`,
            `delay` (the telegram's element), `late_counted` (against the budget).
    """

    cycle: int
    ipoc: int
    q: Array
    q_setpoint: Array
    state: KrcState
    message: str | None
    counters: Mapping[str, int]
