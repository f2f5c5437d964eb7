"""Stamps of a Robot Server, taken only if the environment asks for them; see `deltaq_protocol.stamps`."""

from __future__ import annotations

from typing import Any

import zenoh

from deltaq_protocol.codec import unpack
from deltaq_protocol.errors import ProtocolError
from deltaq_protocol.guarded import Admission, ServerState
from deltaq_protocol.seal import Seal
from deltaq_protocol.stamps import CycleOutcome, Stamps, StampStation
from deltaq_services.phases import MAY_MOVE


class CycleStamps:
    """Stamps each telegram, each state, and each admission as it comes.

    The loop reads its ring channel only with the next telegram, so admissions have a subscriber of their own here.

    Args:
        stamps: where to.
        session: of the Robot Server.
        key: of its admissions.
        seal: the seal of the messages, with which they are only read.
    """

    def __init__(self, stamps: Stamps, session: Any, key: str, seal: Seal) -> None:
        self._stamps = stamps
        self._seal = seal
        self._last: ServerState | None = None
        self._subscriber = session.declare_subscriber(
            key, zenoh.handlers.Callback(self._admission_came, indirect=False)
        )

    def published(self, state: ServerState) -> None:
        """Stamp the telegram of a cycle, and its state, which is on its way now."""
        outcome = outcome_of(state, self._last)
        self._last = state
        self._stamps.add(StampStation.STATE_OUT, state.robot, state.cycle, outcome)
        self._stamps.add(StampStation.TELEGRAM, state.robot, state.cycle, time_ns=round(state.time_s * 1e9))

    def _admission_came(self, sample: Any) -> None:
        try:
            admission = unpack(Admission, self._seal.read(str(sample.key_expr), sample.payload.to_bytes()))
        except ProtocolError:
            return  # whom the loop does not believe either
        self._stamps.add(StampStation.ADMISSION_AT_SERVER, admission.robot, admission.cycle)


def outcome_of(state: ServerState, last: ServerState | None) -> CycleOutcome:
    """What the robot was sent in the cycle of `state`, `last` being the state before."""
    if state.phase not in MAY_MOVE:
        return CycleOutcome.HELD
    if last is not None and _missed(state) > _missed(last):
        return CycleOutcome.REPLY_MISSED
    fresh = state.plan.step == 0 and (last is None or state.sequence != last.sequence)
    return CycleOutcome.FRESH if fresh else CycleOutcome.BRAKED


def _missed(state: ServerState) -> int:
    return state.counters.get("reply_missed", 0)
