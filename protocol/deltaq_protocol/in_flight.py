"""Increments in flight: sent, and not yet visible in a state. For controllers that do not wait for verdicts.

    in_flight = InFlight()
    for state in robot.states():
        for verdict in robot.new_verdicts():
            in_flight.take(verdict)
        dq = ...  # from in_flight.ahead(state).q_cmd
        in_flight.sent(robot.send(dq, state.cycle), dq, state.cycle)

Pure: the caller passes states, verdicts and increments in the order in which they come.

With a jitter buffer (`deltaq_protocol.messages.Playout`) each state names the increments in its setpoint, so no
verdict is needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Phase, Playout, RobotState, Verdict

MOST_MISSED = 4
"""Number of states that a controller still answers with a jitter buffer; answers to older ones are too late."""

PATIENCE_CYCLES = 4
"""An increment without a verdict so many cycles after its setpoint could have been sent is given up."""

_MAY_MOVE = (Phase.READY, Phase.ENGAGED, Phase.BRAKING)


@dataclass(frozen=True, slots=True, eq=False)
class Ahead:
    """The setpoint to which the next increment is added.

    Attributes:
        cycle: cycle of the setpoint.
        q_cmd: (n,) setpoint, if all that was sent is admitted as it was asked for [rad or m].
        dq: (n,) increment that leads to it, where an increment leads to it that was sent [rad or m].
        room: increments for which there is a setpoint to be decided, if none of those sent was lost.
    """

    cycle: int
    q_cmd: Array
    room: int
    dq: Array | None = None


@dataclass(slots=True)
class _Sent:
    seq: int
    cycle: int
    dq: Array
    is_answered: bool = False
    is_refused: bool = False
    setpoint_cycle: int | None = None


@dataclass(slots=True)
class _Account:
    """Increments beyond the setpoint of a state: those decided up to a cycle, followed by those in flight."""

    decided_cycle: int
    decided: list[Array]
    undecided: list[Array]


def is_awaited(state: RobotState) -> bool:
    """Whether the verdict on an answer to this state comes soon enough to wait for it."""
    return state.q_ahead is None and state.playout is None


class InFlight:
    """Increments of one lease, from sending until states show them, or until it is known that no state will."""

    def __init__(self) -> None:
        self._given_up = 0
        self._sent: list[_Sent] = []
        self._lookahead_cycles = 1
        self._newest_cycle = self._answered_cycle = -1
        self._decided_seq = self._decided_cycle = -1
        self._shape = (0,)
        self._told: tuple[int, tuple[float, ...]] | None = None

    def sent(self, seq: int, dq: ArrayLike, cycle: int) -> None:
        """An increment (n,) [rad or m] was sent in answer to the state of `cycle`.

        One that is not finite, or of another length than the robot's, is refused and never reckoned with.
        """
        self._sent.append(_Sent(seq, cycle, np.array(dq, dtype=float)))
        self._answered_cycle = cycle

    def take(self, verdict: Verdict) -> bool:
        """Take a verdict; returns whether it is the first on an increment that was not abandoned.

        Of several on one increment the last counts.
        """
        sent = next((one for one in self._sent if one.seq == verdict.seq), None)
        if sent is None:
            return False
        is_first, sent.is_answered = not sent.is_answered, True
        sent.setpoint_cycle = verdict.setpoint_cycle
        sent.is_refused = verdict.outcome is Outcome.REFUSED
        if verdict.setpoint_cycle is not None:
            sent.dq = np.array(verdict.dq)
            self._decided_cycle = max(self._decided_cycle, verdict.setpoint_cycle)
        elif verdict.outcome is Outcome.HELD:  # its setpoint is one of the brake
            self._decided_cycle = max(self._decided_cycle, verdict.cycle) + 1
        if verdict.outcome is not Outcome.REFUSED:  # the HLI may refuse one before others are decided
            self._decided_seq = max(self._decided_seq, verdict.seq)
        return is_first

    def ahead(self, state: RobotState) -> Ahead:
        """The setpoint to which an increment in answer to this state, the newest so far, is added."""
        self._cycle_passed(state)
        if state.phase not in _MAY_MOVE:
            return Ahead(state.cycle, np.array(state.q_cmd), 1)
        if state.playout is not None:
            return self._behind_playout(state, state.playout)
        q_cmd, account = np.array(_told(state)[1]), self._account(state)
        for dq in (*account.decided, *account.undecided):
            q_cmd = q_cmd + dq
        cycle = account.decided_cycle + len(account.undecided)
        return Ahead(cycle, q_cmd, max(1, state.cycle + self._lookahead_cycles - cycle))

    def take_given_up(self) -> int:
        """The number of increments without a verdict that were given up since the last call."""
        given_up, self._given_up = self._given_up, 0
        return given_up

    def cycles_to_answer(self, state: RobotState) -> Sequence[int]:
        """The cycles for which increments are due now: that of the state, and those of missed states.

        An increment that was not sent leaves a setpoint of the lookahead unused. It can be sent later, as long as
        there is room for it.
        """
        missed = max(0, state.cycle - self._answered_cycle - 1) if self._answered_cycle >= 0 else 0
        count = min(self.ahead(state).room, 1 + missed)
        return range(state.cycle - count + 1, state.cycle + 1)

    def _cycle_passed(self, state: RobotState) -> None:
        if state.cycle < self._newest_cycle:  # another Robot Server, which counts from one
            self._give_up(self._sent)
            self._lookahead_cycles = 1
            self._answered_cycle = self._decided_cycle = -1
        self._newest_cycle, self._shape = state.cycle, (len(state.q_cmd),)
        if state.playout is not None:
            self._give_up_beside(state, state.playout)
            return
        self._lookahead_cycles = max(self._lookahead_cycles, _told(state)[0] - state.cycle)
        if state.phase not in _MAY_MOVE:
            for one in self._sent:
                one.setpoint_cycle = None  # a hold has cleared the Robot Server's increments
                self._decided_seq = max(self._decided_seq, one.seq)
        self._infer_decided(state)
        oldest = state.cycle - self._lookahead_cycles - PATIENCE_CYCLES
        self._give_up([one for one in self._sent if one.cycle <= oldest])

    def _behind_playout(self, state: RobotState, playout: Playout) -> Ahead:
        """The setpoint after all increments later than the one that it includes, if each has its turn."""
        first, q_ahead = _told(state)
        q_cmd, dq = np.array(q_ahead), None
        if playout.owed is not None:
            q_cmd = q_cmd + np.array(playout.owed)
        for one in self._sent:
            if one.cycle > _answered(playout) and not one.is_refused and self._can_be_admitted(one):
                q_cmd, dq = q_cmd + one.dq, one.dq
        return Ahead(first - 1 + playout.delay_cycles, q_cmd, 1 + MOST_MISSED, dq)

    def _give_up_beside(self, state: RobotState, playout: Playout) -> None:
        """Of those that had their turn the verdict has come, or was lost; others have been under way for too long."""
        longest_cycles = 2 * playout.delay_cycles + PATIENCE_CYCLES
        oldest = max(_answered(playout) - PATIENCE_CYCLES, state.cycle - longest_cycles)
        self._give_up([one for one in self._sent if one.cycle <= oldest])

    def _infer_decided(self, state: RobotState) -> None:
        """A state may know of verdicts that have not come, or never will: increments are decided in their order."""
        first, q_ahead = _told(state)
        before, self._told = self._told, (first, q_ahead)
        unheard = first - 1 - max(self._decided_cycle, state.cycle)
        if q_ahead == state.q_cmd:  # a robot at rest has a setpoint as far ahead without any verdict
            unheard = 0
        undecided = self._undecided()
        if undecided and before is not None and before[0] == first - 1:
            shown = np.array(before[1]) + undecided[0].dq
            unheard = max(unheard, int(tuple(shown.tolist()) == q_ahead))
        if unheard > 0:
            self._decided_seq = max([self._decided_seq, *(one.seq for one in undecided[:unheard])])
            self._decided_cycle = max(self._decided_cycle, first - 1)

    def _undecided(self) -> list[_Sent]:
        return [one for one in self._unanswered() if one.seq > self._decided_seq]

    def _unanswered(self) -> list[_Sent]:
        """Those without a verdict that can be admitted."""
        return [one for one in self._sent if not one.is_answered and self._can_be_admitted(one)]

    def _can_be_admitted(self, one: _Sent) -> bool:
        return one.dq.shape == self._shape and bool(np.isfinite(one.dq).all())

    def _give_up(self, increments: Sequence[_Sent]) -> None:
        self._given_up += sum(not one.is_answered for one in increments)
        gone = {one.seq for one in increments}
        self._sent = [one for one in self._sent if one.seq not in gone]

    def _account(self, state: RobotState) -> _Account:
        first, _ = _told(state)
        decided = {
            one.setpoint_cycle: one.dq
            for one in self._sent
            if one.setpoint_cycle is not None and one.setpoint_cycle >= first
        }
        last = max(decided, default=first - 1)
        # a verdict that is missing before another was lost, or is late
        lost = [one.dq for one in self._unanswered() if one.seq < self._decided_seq]
        gaps = last + 1 - first - len(decided)
        filled = lost[-gaps:] if gaps > 0 else []
        in_order = [decided[cycle] for cycle in sorted(decided)]
        undecided = [one.dq for one in self._undecided()[-self._lookahead_cycles :]]
        return _Account(last, [*in_order, *filled], undecided)


def _answered(playout: Playout) -> int:
    return -1 if playout.answered_cycle is None else playout.answered_cycle


def _told(state: RobotState) -> tuple[int, tuple[float, ...]]:
    """The cycle that an increment goes into, and the setpoint that it is added to, from a state."""
    if state.setpoint_cycle is None or state.q_ahead is None:
        return state.cycle + 1, state.q_cmd
    return state.setpoint_cycle, state.q_ahead
