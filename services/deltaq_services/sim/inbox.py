"""The requests of one robot: which is the newest, which are invalid, and what has been decided already."""

from __future__ import annotations

from deltaq_protocol.guarded import Request, ServerState
from deltaq_protocol.messages import Phase, Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE

_AHEAD_CYCLES = 2
"""A request may overtake the state that it answers by this much."""


class Inbox:
    """Keeps the newest valid request until it is decided, once a cycle.

    Args:
        joints: of the robot.
        max_age_cycles: an increment that answers an older state is stale.

    Attributes:
        waiting: the request to be decided next.
        decided_cycle: cycle of the state that was decided last.
        lease_epoch, seq: lease and sequence number of the newest valid request.
    """

    def __init__(self, joints: int, max_age_cycles: int) -> None:
        self.waiting: Request | None = None
        self.decided_cycle = -1
        self.lease_epoch, self.seq = 0, -1
        self._joints = joints
        self._max_age_cycles = max_age_cycles

    def fault(self, request: Request) -> Reason | None:
        """Why a request with an increment is invalid, as far as that is known before it is decided."""
        count = 0 if request.dq is None else len(request.dq)
        if count != self._joints:
            return Reason(code=ReasonCode.BAD_SHAPE, what="dq", value=count, bound=self._joints)
        if request.lease_epoch < self.lease_epoch:
            return Reason(
                code=ReasonCode.LEASE_NOT_HELD,
                what="lease_epoch",
                value=request.lease_epoch,
                bound=self.lease_epoch,
            )
        if request.lease_epoch == self.lease_epoch and request.seq <= self.seq:
            return Reason(code=ReasonCode.REPLAYED_SEQUENCE, what="seq", value=request.seq, bound=self.seq)
        return None

    def put(self, request: Request) -> Request | None:
        """Let a valid request wait; returns the one that it replaces."""
        self.lease_epoch, self.seq = request.lease_epoch, request.seq
        replaced, self.waiting = self.waiting, request
        return replaced

    def take(self) -> Request | None:
        """Remove and return the waiting request."""
        request, self.waiting = self.waiting, None
        return request

    def due(self, state: ServerState) -> bool:
        """Whether a request waits that can be decided, or refused, on this state."""
        if self.waiting is None or self.decided_cycle == state.cycle:
            return False
        return not state.cycle < self.waiting.cycle <= state.cycle + _AHEAD_CYCLES

    def fault_on(self, state: ServerState, stopping: bool) -> Reason | None:
        """Why the waiting request cannot be decided on this state."""
        assert self.waiting is not None  # asked only when one is due
        cycle, oldest = self.waiting.cycle, state.cycle - self._max_age_cycles
        if cycle > state.cycle:
            return Reason(code=ReasonCode.FUTURE_CYCLE, what="cycle", value=cycle, bound=state.cycle)
        if cycle < oldest:
            return Reason(code=ReasonCode.STALE_CYCLE, what="cycle", value=cycle, bound=oldest)
        if state.phase is Phase.OFFLINE:
            return Reason(code=ReasonCode.NOT_READY)
        if state.phase not in MAY_MOVE or stopping:
            return Reason(code=ReasonCode.STOPPED)
        return None
