"""Checks of increments from controllers, and their forwarding to the gate."""

from typing import Any

from deltaq_protocol import topics
from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import EarlierIncrement, Error, Increment, Outcome, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.commands import Deed
from deltaq_services.hli.leases import Lease
from deltaq_services.hli.playout import MOST_CARRIED_CYCLES, Asked, Fate, Left, PlayoutBuffer
from deltaq_services.hli.robot_link import RobotLink
from deltaq_services.hli.state import HliState, answered_by_error, at_fault, unknown_robot
from deltaq_services.outputs import ClientOrigin, Output, Sender, ToSender, ToTopic


class Increments:
    """Checks increments, and forwards the newest one of each cycle to the gate.

    Each handler takes the monotonic time [s], and returns the messages to send.
    """

    def __init__(self, state: HliState) -> None:
        self._state = state

    def on_increment(self, increment: Increment, sender: Sender | None, time_s: float) -> list[Output]:
        """Take an increment of a controller: forward it now or with the next state, or refuse it.

        With a jitter buffer, earlier increments that were lost come with it.
        """
        outputs = self._state.tick(time_s)
        lease, link = self._lease_and_link(increment)
        if lease is not None and link is not None and link.playout is not None:
            for earlier in increment.earlier:
                if lease.sequence.is_new(earlier.seq):
                    self._state.counters["increments_repeated"] += 1
                    lease.brought.add(earlier.seq)
                    outputs += self._take(_again(earlier, increment), sender, time_s)
            if lease.take_brought(increment.seq):
                self._state.counters["increments_overtaken"] += 1
                return outputs
        return outputs + self._take(increment, sender, time_s)

    def _take(self, increment: Increment, sender: Sender | None, time_s: float) -> list[Output]:
        self._state.counters["increments"] += 1
        robot, seq, cycle = increment.robot, increment.seq, increment.cycle
        lease, link = self._lease_and_link(increment)
        reason = self._sequence_fault(robot, lease, seq, time_s)
        if reason is None and link is not None:
            reason = self._state.mismatch() or link.fault(increment, time_s)
        if reason is not None or lease is None or link is None:
            why = reason or unknown_robot(robot)
            return self._state.refuse(robot, cycle, seq, why, sender, lease is not None)
        lease.used = True
        link.sight, link.target = increment.sight, increment.target
        assert link.state is not None  # without one it would have been refused
        asked = Asked(increment, lease.epoch, sender, came=link.state.cycle)
        if link.playout is not None:
            return self._put_into(link.playout, asked)
        send, replaced = link.offer(asked)
        outputs = [] if replaced is None else self._state.refuse_asked(replaced, _superseded())
        if send is not None:
            outputs.append(self._request(robot, link, send))
        return outputs

    def _lease_and_link(self, increment: Increment) -> tuple[Lease | None, RobotLink | None]:
        """Under which lease it was sent, and its robot."""
        robot = increment.robot
        return self._state.leases.held_with(robot, increment.lease), self._state.links.get(robot)

    def on_bad_increment(
        self, error: InvalidMessageError, sender: Sender | None, time_s: float
    ) -> list[Output]:
        """Refuse an undecodable increment like any other, if it names its robot and sender."""
        outputs = self._state.tick(time_s)
        self._state.counters["increments"] += 1
        data: dict[str, Any] = error.data
        robot, seq, cycle = data.get("robot"), data.get("seq"), data.get("cycle")
        try:
            verdict = Verdict(robot=robot, seq=seq, cycle=cycle, outcome=Outcome.REFUSED)
        except ValueError:
            verdict = None
        if verdict is None or (error.code is ReasonCode.MALFORMED and sender is not None):
            return outputs + self.on_malformed(error, sender)
        lease = self._state.leases.held_with(verdict.robot, data.get("lease"))
        reason = self._sequence_fault(verdict.robot, lease, verdict.seq, time_s)
        if reason is None:
            reason = at_fault(data.get("dq"), self._state.cell.robots[verdict.robot], error.code)
        asked = verdict.robot, verdict.cycle, verdict.seq
        return outputs + self._state.refuse(*asked, reason, sender, lease is not None)

    def on_malformed(self, error: InvalidMessageError, sender: Sender | None) -> list[Output]:
        """Count and answer a malformed message."""
        self._state.counters["malformed"] += 1
        origin = ClientOrigin(address="zenoh") if sender is None else sender.origin
        # what it holds may be a secret in the wrong place
        text = str(error).partition(", got ")[0]
        self._state.tell(Deed(AuditKind.MESSAGE, AuditOutcome.REFUSED, origin, code=error.code, text=text))
        if sender is None:
            return []
        hint = "`deltaq schema` prints the schema of every message"
        answered = answered_by_error(error.data)
        return [ToSender(sender, Error(code=error.code, message=str(error), hint=hint, **answered))]

    def on_cycle(self, robot: str, link: RobotLink, time_s: float) -> list[Output]:
        """Begin a robot's cycle on its state: request its due increment of the gate, or send a due heartbeat."""
        asked, outputs = self._whose_turn(link, time_s)
        if asked is not None:
            return [self._request(robot, link, asked), *outputs]
        if link.is_in_step:
            return outputs
        self._state.counters["signs_of_life"] += 1
        assert link.state is not None  # it has just come
        lease = self._state.leases.of(robot)
        alive = Request(robot=robot, cycle=link.state.cycle, lease_epoch=lease.epoch if lease else 0)
        return [ToTopic(topics.REQUEST, robot, alive), *outputs]

    def _whose_turn(self, link: RobotLink, time_s: float) -> tuple[Asked | None, list[Output]]:
        """The increment to be sent now, if there is one, and refusals of others."""
        outputs: list[Output] = []
        if link.playout is None:
            asked = link.take_waiting()
        else:
            assert link.state is not None  # it has just come
            turn = link.playout.turn(link.state.cycle, link.last_dq)
            asked = turn.asked
            for left in turn.left:
                outputs += self._tell_of(left)
        if asked is None:
            return None, outputs
        # the robot may have been held, or a state been lost
        reason = self._state.mismatch() or link.outdated(asked, time_s)
        if reason is not None:
            return None, [*outputs, *self._state.refuse_asked(asked, reason)]
        send, _ = link.offer(asked)
        return send, outputs

    def _put_into(self, playout: PlayoutBuffer, asked: Asked) -> list[Output]:
        left = playout.put(asked, asked.came)
        return [] if left is None else self._tell_of(left)

    def _tell_of(self, left: Left) -> list[Output]:
        """The verdict on an increment that has no turn of its own."""
        if left.fate is Fate.SUPERSEDED:
            return self._state.refuse_asked(left.asked, _superseded())
        late = Reason(
            code=ReasonCode.LATE, what="cycles", value=float(left.late_cycles), bound=MOST_CARRIED_CYCLES
        )
        if left.fate is Fate.LATE:
            return self._state.refuse_asked(left.asked, late)
        return self._state.carry(left.asked, late)

    def _request(self, robot: str, link: RobotLink, asked: Asked) -> Output:
        self._state.counters["requests"] += 1
        assert link.state is not None  # nothing is due before the first state
        increment, newest = asked.increment, link.state.cycle
        return ToTopic(
            topics.REQUEST,
            robot,
            Request(
                robot=robot,
                # the age of one that waited for its turn has been looked at, and is no fault of the way to the gate
                cycle=increment.cycle if link.playout is None else newest,
                newest=newest,
                lease_epoch=asked.lease_epoch,
                seq=increment.seq,
                dq=increment.dq,
            ),
        )

    def _sequence_fault(self, robot: str, lease: Lease | None, seq: int, time_s: float) -> Reason | None:
        """Lease and sequence; a number counts as used once it was seen, even if the increment is refused.

        A new number shows that the holder lives, and renews the lease; a duplicate shows nothing.
        """
        if robot not in self._state.links:
            return unknown_robot(robot)
        if lease is None:
            return Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease")
        newest = lease.sequence.newest
        if not lease.sequence.take(seq):
            return Reason(
                code=ReasonCode.REPLAYED_SEQUENCE, what="seq", value=float(seq), bound=float(newest)
            )
        self._state.leases.renew(lease, time_s)
        return None


def _again(earlier: EarlierIncrement, bringer: Increment) -> Increment:
    """An increment that was lost, as the one says that brought it."""
    return Increment(
        robot=bringer.robot,
        seq=earlier.seq,
        cycle=earlier.cycle,
        dq=earlier.dq,
        lease=bringer.lease,
        sight=bringer.sight,
        target=bringer.target,
    )


def _superseded() -> Reason:
    return Reason(code=ReasonCode.SUPERSEDED, what="increment")
