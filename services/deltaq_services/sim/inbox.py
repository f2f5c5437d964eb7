"""The requests of one robot: the newest, the one carried over, the invalid ones, and those already decided.

At most one request is *carried over* to the next cycle: one that came when its cycle had been decided already, or
one whose admission the Robot Server did not take in time. It is decided on the next state, as soon as the HLI has
sent a message in that cycle: only then is it known that there is no newer request and that its lease is valid. After
that it is out of date.
"""

from deltaq_protocol.guarded import Request, ServerState
from deltaq_protocol.messages import Phase, Reason
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE

_AHEAD_CYCLES = 2
"""A request may overtake the state that it answers by this much."""

_IN_HAND_CYCLES = 1
"""A request that was carried over may answer a state older than the newest by this many cycles."""


class Inbox:
    """Keeps the newest valid request until it is decided: one for each setpoint.

    Args:
        joints: of the robot.
        max_age_cycles: an increment that answers an older state is stale.
        lookahead_cycles: number of setpoints that may be decided before they are sent.

    Attributes:
        waiting: the request to be decided next.
        decided: the request behind the admission in flight; None where it must not be decided again.
        decided_cycle: the last decided setpoint is sent after this cycle.
        spoken_cycle: cycle in which the HLI spoke last.
        lease_epoch, seq: lease and sequence number of the newest valid request.
    """

    def __init__(self, joints: int, max_age_cycles: int, lookahead_cycles: int = 1) -> None:
        self.waiting: Request | None = None
        self.decided: Request | None = None
        self.decided_cycle = self.spoken_cycle = -1
        self.lease_epoch, self.seq = 0, -1
        self._joints = joints
        self._max_age_cycles = max_age_cycles
        self._lookahead_cycles = lookahead_cycles

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

    def put(self, request: Request, newest_cycle: int) -> Request | None:
        """Store a valid request as the waiting one; returns the replaced request.

        Args:
            request: with an increment.
            newest_cycle: cycle of the robot's newest state, -1 before the first.
        """
        self.lease_epoch, self.seq = request.lease_epoch, request.seq
        sent = _sent_in(request)
        is_near = sent <= newest_cycle + _AHEAD_CYCLES
        self.spoken_cycle = max(self.spoken_cycle, newest_cycle, sent if is_near else newest_cycle)
        self.decided = None
        replaced, self.waiting = self.waiting, request
        return replaced

    def heartbeat(self, request: Request, newest_cycle: int) -> Request | None:
        """Note that the HLI has no newer request in a cycle.

        Returns:
            The waiting request, removed, if its lease has ended; None otherwise.
        """
        if not newest_cycle <= request.cycle <= newest_cycle + _AHEAD_CYCLES:
            return None  # it was said in a cycle before, or of another Robot Server process
        self.spoken_cycle = max(self.spoken_cycle, request.cycle)
        if self.decided is not None and self.decided.lease_epoch != request.lease_epoch:
            self.decided = None
        if self.waiting is not None and self.waiting.lease_epoch != request.lease_epoch:
            return self.take()
        return None

    def cycle_passed(self, cycle: int, missed: bool) -> Request | None:
        """Begin a new cycle.

        Args:
            cycle: of the state.
            missed: the Robot Server did not take the admission in flight. It takes none for an earlier state after it
                has published a new one, so the request behind it has moved nothing, and never will.

        Returns:
            The waiting request, removed, if it has waited too long; None otherwise.
        """
        oldest = cycle - _IN_HAND_CYCLES
        if missed:  # no decision for a later cycle will be sent, and new requests need more time
            self.decided_cycle = cycle + self._lookahead_cycles - 2
        decided, self.decided = self.decided, None
        if self.waiting is not None:
            return self.take() if self.waiting.cycle < oldest else None
        if decided is not None and missed and decided.cycle >= oldest:
            self.waiting = decided
        return None

    def forget(self) -> Request | None:
        """Drop the request that was carried over, and return it."""
        self.decided = None
        return self.take()

    def begin_anew(self) -> None:
        """Start again for another Robot Server process, whose cycles are counted from one."""
        self.decided = None
        self.decided_cycle = self.spoken_cycle = -1

    def take(self) -> Request | None:
        """Remove and return the waiting request."""
        request, self.waiting = self.waiting, None
        return request

    def due(self, state: ServerState) -> bool:
        """Whether a request waits that can be decided, or refused, on this state."""
        if self.waiting is None or self.spoken_cycle < state.cycle:
            return False
        if self.goes_after(state) >= state.cycle + self._lookahead_cycles:
            return False
        # what was sent after a state that is still on its way here would be too late on this one
        return not state.cycle < _sent_in(self.waiting) <= state.cycle + _AHEAD_CYCLES

    def goes_after(self, state: ServerState) -> int:
        """The next decision on this state is for the setpoint sent after the returned cycle.

        It follows the last decided setpoint. If that has been sent already, a braking robot gets the next possible
        setpoint; a resting one the latest that the lookahead allows, so that many admissions are in flight.
        """
        if self.decided_cycle >= state.cycle - 1:
            return self.decided_cycle + 1
        rests = state.plan.step >= state.plan.brake_cycles
        return state.cycle + self._lookahead_cycles - 1 if rests else state.cycle

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


def _sent_in(request: Request) -> int:
    """The cycle in which the HLI sent a request, if the request says so."""
    return max(request.cycle, request.newest or 0)
