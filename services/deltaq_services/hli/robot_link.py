"""The HLI's data of one robot: its newest state, and the increments for the gate.

At most one increment goes to the gate per robot and cycle. A second one within the cycle is carried over to the next
state, and no further; of several only the newest is kept. With a jitter buffer all wait there.
"""

import math
from collections.abc import Iterable

import numpy as np

from deltaq_protocol.guarded import ServerState
from deltaq_protocol.messages import Increment, Outcome, Phase, Reason, Sight, Verdict, ViewTarget, ViewWish
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.containment import Part
from deltaq_services.hli.playout import Asked, CarriedMotion, PlayoutBuffer
from deltaq_services.outputs import Sender

# Future setpoints by the gate's verdicts, in a cell with a lookahead.
#
# Clients get them to know the setpoint to which their next increment is added. They are not safety-relevant: the gate
# keeps its own account.


class AdmittedAhead(Part):
    """The future setpoints of one robot if it takes all admissions in flight.

    Args:
        cycles: number of setpoints that may be decided before they are sent.
        cycle_s: sample time of the robot.
    """

    def __init__(self, cycles: int, cycle_s: float) -> None:
        self.cycles = cycles
        self._cycle_s = cycle_s
        self._verdicts: dict[int, Verdict] = {}
        self._decided, self._chain_cycle = -1, 0

    def decided(self, verdict: Verdict, state: ServerState) -> None:
        """Note that the gate has decided an increment; `state` is the newest."""
        if verdict.cycle < self._chain_cycle:
            return  # of a chain that broke
        if verdict.setpoint_cycle is not None:
            self._verdicts[verdict.setpoint_cycle] = verdict
            self._decided = max(self._decided, verdict.setpoint_cycle)
        elif verdict.outcome is Outcome.HELD:
            self._decided = self.setpoint_cycle(state)  # for the brake

    def cycle_passed(self, state: ServerState) -> None:
        """Begin a new cycle. If the last admission was not taken, no later one will be, since they follow it."""
        last = state.cycle + self.cycles
        if self._decided > last:  # another process counts from one
            self._verdicts, self._decided, self._chain_cycle = {}, -1, 0
        due = self._verdicts.get(state.cycle)
        if due is not None and due.dq != state.dq:
            # as the gate does: the next increment has the whole time
            self._verdicts, self._decided, self._chain_cycle = {}, last - 1, state.cycle
        self._verdicts = {cycle: verdict for cycle, verdict in self._verdicts.items() if cycle >= state.cycle}

    def setpoint_cycle(self, state: ServerState) -> int:
        """The cycle of the setpoint for the next increment, by the gate's rule."""
        if self._decided >= state.cycle:
            return min(self._decided + 1, state.cycle + self.cycles)
        rests = state.plan.step >= state.plan.brake_cycles
        return state.cycle + (self.cycles if rests else 1)

    def q_ahead(self, state: ServerState) -> tuple[float, ...]:
        """(n,) setpoint of the last cycle before that [rad or m]."""
        motion = SetpointMotion.of(state)
        for cycle in range(state.cycle + 1, self.setpoint_cycle(state)):
            verdict = self._verdicts.get(cycle)
            if verdict is None or verdict.time_to_stop_s is None:
                motion = motion.braked()
            else:
                brake_cycles = max(1, round(verdict.time_to_stop_s / self._cycle_s))
                motion = motion.sent(np.array(verdict.dq), brake_cycles, 0, state.sequence)
        return tuple(motion.q_cmd.tolist())


_MAX_AWAITED = 64
"""Increments whose verdict may be outstanding; a gate that answers keeps this at one or two."""

_IN_HAND_CYCLES = 1
"""An increment that came in a cycle is passed on in that one or so many later."""


class RobotLink(Part):
    """Newest state and increment of one robot.

    Args:
        joints: number of joints, n.
        max_age_cycles: an increment that answers a cycle older than this is stale.
        max_state_age_s: a robot whose newest state is older than this is taken for offline.
        max_playout_cycles: the same bound under a lease with a jitter buffer, including the time in the buffer.
        carried: makes the store of deferred motion.
        admitted: the known future setpoints; None without a lookahead.

    Attributes:
        joints: as given.
        playout: the jitter buffer of the lease; None if it did not ask for one.
        sight: how well the controller sees its target; None if it does not say.
        target: its target; None if it does not say.
        view: the requested view of its camera; None before the first request.
        state, received_s: newest state of the robot, and the time of its arrival [s].
        is_in_step: whether the gate has decided the increment of the last cycle, and the robot has taken it. Then no
            increment waits in the gate, and the gate needs no heartbeat before the next increment.
    """

    def __init__(
        self,
        joints: int,
        max_age_cycles: int,
        max_state_age_s: float,
        max_playout_cycles: int,
        carried: CarriedMotion,
        admitted: AdmittedAhead | None = None,
    ) -> None:
        self.joints = joints
        self._max_age_cycles = max_age_cycles
        self._max_playout_cycles = max_playout_cycles
        self._carried = carried
        self.sight: Sight | None = None
        self.target: ViewTarget | None = None
        self.view: ViewWish | None = None
        self.playout: PlayoutBuffer | None = None
        self._max_state_age_s = max_state_age_s
        self._asked_cycle: int | None = None
        self._answered_cycle = -1
        self._awaited: dict[int, Sender | None] = {}
        self._undecided: int | None = None
        self.is_in_step = False
        self._waiting: Asked | None = None
        self._admitted = admitted
        self.state: ServerState | None = None
        self.received_s = -math.inf

    @property
    def parts(self) -> Iterable[object]:
        """The objects that change."""
        playout = () if self.playout is None else (self.playout, self.playout.carried)
        return self, *playout, *(() if self._admitted is None else (self._admitted,))

    def phase(self, time_s: float) -> Phase:
        """Phase of the robot; offline without a fresh state."""
        if self.state is None or time_s - self.received_s > self._max_state_age_s:
            return Phase.OFFLINE
        return self.state.phase

    def begin_playout(self) -> PlayoutBuffer:
        """Make increments wait in a jitter buffer until the lease ends; returns the buffer."""
        self.playout = PlayoutBuffer(self._max_playout_cycles, self._carried.snapshot())
        return self.playout

    def fault(self, increment: Increment, time_s: float) -> Reason | None:
        """Why the robot cannot take this increment now, or None if it can."""
        if len(increment.dq) != self.joints:
            return Reason(
                code=ReasonCode.BAD_SHAPE,
                what="dq",
                value=float(len(increment.dq)),
                bound=float(self.joints),
            )
        return self.cannot_move(time_s) or self._age_fault(increment.cycle)

    def cannot_move(self, time_s: float) -> Reason | None:
        """Why the robot can take no increment now, or None if it can."""
        phase = self.phase(time_s)
        if self.state is None or phase is Phase.OFFLINE:
            age = None if self.state is None else time_s - self.received_s
            return Reason(
                code=ReasonCode.NOT_READY, what="state age [s]", value=age, bound=self._max_state_age_s
            )
        if phase is Phase.HELD:
            return Reason(code=ReasonCode.STOPPED, what=self.state.reason or "")
        return None

    def _age_fault(self, cycle: int) -> Reason | None:
        assert self.state is not None  # it can move
        newest = self.state.cycle
        if cycle > newest:
            return Reason(code=ReasonCode.FUTURE_CYCLE, what="cycle", value=float(cycle), bound=float(newest))
        if self.playout is not None:
            under_way, longest = newest - cycle, self._max_playout_cycles
            too_slow = Reason(
                code=ReasonCode.LINK_TOO_SLOW, what="cycles", value=float(under_way), bound=float(longest)
            )
            return too_slow if under_way > longest else None
        if newest - cycle > self._max_age_cycles:
            return Reason(
                code=ReasonCode.STALE_CYCLE,
                what="cycle",
                value=float(cycle),
                bound=float(newest - self._max_age_cycles),
            )
        return None

    def outdated(self, waited: Asked, time_s: float) -> Reason | None:
        """Why an increment that waited cannot be passed on now, or None if it can.

        Without a jitter buffer it is carried over for one cycle, and the state after the one in which it came may be
        lost.
        """
        if self.playout is not None:
            return self.cannot_move(time_s)
        if (fault := self.fault(waited.increment, time_s)) is not None:
            return fault
        assert self.state is not None  # it came after a state
        oldest = self.state.cycle - _IN_HAND_CYCLES
        if waited.came >= oldest:
            return None
        return Reason(
            code=ReasonCode.STALE_CYCLE, what="cycle", value=float(waited.came), bound=float(oldest)
        )

    def take_state(self, state: ServerState, time_s: float) -> None:
        """Take the state of a new cycle, or one that is repeated while the robot's controller is silent."""
        before = self.state
        is_next = before is not None and before.cycle == state.cycle - 1 == self._asked_cycle
        took_it = before is not None and self._undecided is None and state.sequence > before.sequence
        self.is_in_step = is_next and took_it and self.playout is None
        self.state = state
        self.received_s = time_s
        self._answered_cycle = min(self._answered_cycle, state.cycle)  # another process counts from one
        if self._admitted is not None:
            self._admitted.cycle_passed(state)
        if self.playout is not None:
            self.playout.moved(state.cycle, state.plan)

    def decided(self, verdict: Verdict) -> tuple[bool, Sender | None]:
        """Take a decision of the gate; returns whether its verdict is awaited, and by which client."""
        if self._admitted is not None and self.state is not None:
            self._admitted.decided(verdict, self.state)
        if verdict.seq == self._undecided:
            self._undecided = None
        if verdict.seq not in self._awaited:
            return False, None
        return True, self._awaited.pop(verdict.seq)

    @property
    def last_dq(self) -> tuple[float, ...] | None:
        """(n,) the last increment of the setpoint [rad or m]; None with a lookahead."""
        return None if self._admitted is not None or self.state is None else self.state.dq

    def told_ahead(self) -> tuple[tuple[float, ...] | None, int | None]:
        """The setpoint (n,) [rad or m] to which an increment is added now, and the cycle that it goes into."""
        if self._admitted is None or self.state is None:
            return None, None
        return self._admitted.q_ahead(self.state), self._admitted.setpoint_cycle(self.state)

    def offer(self, asked: Asked) -> tuple[Asked | None, Asked | None]:
        """Offer an increment.

        Returns:
            The increment to send now, if any, and the one that it took the place of, if any.
        """
        if self._is_due(asked):
            return self._sent(asked), self.take_waiting()
        replaced, self._waiting = self._waiting, asked
        return None, replaced

    @property
    def waits(self) -> bool:
        """Whether an increment waits for the next state."""
        return self._waiting is not None

    def drop(self) -> list[Asked]:
        """Forget the increments that wait, and return them."""
        waited = [] if self.playout is None else self.playout.drop()
        asked = self.take_waiting()
        return waited if asked is None else [*waited, asked]

    def end_lease(self) -> list[Asked]:
        """End the lease: drop and return the waiting increments."""
        waited = self.drop()
        self.playout = self.sight = self.target = None
        return waited

    def take_waiting(self) -> Asked | None:
        """Take the increment that was carried over, if there is one."""
        asked, self._waiting = self._waiting, None
        return asked

    def _is_due(self, asked: Asked) -> bool:
        if self.state is None:
            return False
        # with a lookahead the answer to each state has a setpoint of its own, though two come in one cycle
        has_its_own = self._admitted is not None and asked.increment.cycle > self._answered_cycle
        return self._asked_cycle != self.state.cycle or has_its_own

    def _sent(self, asked: Asked) -> Asked:
        assert self.state is not None  # nothing is due before the first state
        self._asked_cycle, self._answered_cycle = self.state.cycle, asked.increment.cycle
        self._awaited[asked.increment.seq] = asked.sender
        self._undecided = asked.increment.seq
        while len(self._awaited) > _MAX_AWAITED:
            self._awaited.pop(next(iter(self._awaited)))
        return asked
