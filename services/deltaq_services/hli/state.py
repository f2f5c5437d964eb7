"""The state of the HLI: leases, robots, commands and counters, and what happens when a lease ends."""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from deltaq_cell.description import CellDescription, RobotDescription
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.guarded import Command, Health
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.messages import (
    MOST,
    MOST_OF_A_JOINT,
    Done,
    Error,
    IoReply,
    Outcome,
    Phase,
    Reason,
    Verdict,
)
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_services.containment import Part
from deltaq_services.hli.commands import Commands, Deed, Tell, deed_of, told_to_nobody
from deltaq_services.hli.leases import Lease, Leases
from deltaq_services.hli.playout import Asked, CarriedMotion
from deltaq_services.hli.robot_link import AdmittedAhead, RobotLink
from deltaq_services.outputs import NOBODY, ClientOrigin, Output, Sender, ToSender, ToTopic
from deltaq_services.rate_limit import RateLimit

# Refusals: the answers to increments that are no valid requests.

_LONGEST_NAME = 64


def refusal(
    robot: str,
    cycle: int,
    seq: int,
    reason: Reason,
    sender: Sender | None,
    is_holders: bool,
    outcome: Outcome = Outcome.REFUSED,
) -> list[Output]:
    """Send the HLI's verdict on an increment to the sender; on the holder's, to every watcher too.

    A sender over zenoh reads the open verdict: a zenoh sample does not say where it came from. It holds the lease, or
    has just lost it.
    """
    verdict = Verdict(robot=robot, cycle=cycle, seq=seq, outcome=outcome, reasons=(reason,))
    outputs: list[Output] = [] if sender is None else [ToSender(sender, verdict)]
    if is_holders or sender is None:
        outputs.append(ToTopic(topics.VERDICT, robot, verdict))
    return outputs


def answered_by_error(data: Mapping[str, object]) -> dict[str, Any]:
    """The fields of an `Error` that name the request which it answers; the request's fields may hold any values."""
    kind, robot, seq = data.get("type"), data.get("robot"), data.get("seq")
    return {
        "request": _text(kind) if isinstance(kind, str) else None,
        "robot": _text(robot) if isinstance(robot, str) else None,
        "seq": seq if isinstance(seq, int) and not isinstance(seq, bool) and abs(seq) < 2**63 else None,
    }


def _text(name: str) -> str:
    """A name as it can be sent: JSON can smuggle in half a surrogate pair, which is no text."""
    return name[:_LONGEST_NAME].encode(errors="replace").decode()


def unknown_robot(robot: str) -> Reason:
    """The error for a robot that the cell does not have."""
    return Reason(code=ReasonCode.UNKNOWN_ROBOT, what=robot)


def at_fault(dq: object, robot: RobotDescription, code: ReasonCode) -> Reason:
    """The fault of a `dq` that could not be decoded.

    Args:
        dq: the value received.
        robot: the robot it was meant for.
        code: the fault found by the codec.

    Returns:
        For a wrong length, both lengths; for an element that is not finite, the joint's name; for one that is too
        large, its value and bound too.
    """
    joints = robot.joint_names
    if not isinstance(dq, list):
        return Reason(code=code, what="dq")
    if len(dq) != len(joints):
        return Reason(code=ReasonCode.BAD_SHAPE, what="dq", value=float(len(dq)), bound=float(len(joints)))
    for joint, element in zip(joints, dq, strict=True):
        if element is None or (isinstance(element, float) and not math.isfinite(element)):
            return Reason(code=code, what=joint)
        if isinstance(element, int | float) and abs(element) > MOST_OF_A_JOINT:
            value = float(max(-MOST, min(element, MOST)))
            return Reason(code=code, what=joint, value=value, bound=MOST_OF_A_JOINT)
    return Reason(code=code, what="dq")


MOST_COMMANDS_S = 100.0
"""Commands of clients that the gate gets in a second, and at once: each costs it time. Stops do not count."""


class HliState(Part):
    """State of the HLI, shared by the parts of its core.

    Args:
        cell: description of the cell.
        identity: its name and hash.
        new_token: makes a secret, different each time.
        first_epoch: greater than any lease epoch or command id used before, as far as that can be known.
        tell: takes actions, for the audit log.
    """

    def __init__(
        self,
        cell: CellDescription,
        identity: CellIdentity,
        new_token: Callable[[], str],
        first_epoch: int,
        tell: Tell = told_to_nobody,
    ) -> None:
        age_s, ahead = cell.gate.max_request_age_s, cell.gate.lookahead_cycles
        self.cell = cell
        self.identity = identity
        self.tell = tell
        self.mismatches: dict[str, str] = {}
        self.counters: Counter[str] = Counter()
        self.leases = Leases(cell.robots, cell.lease_s, new_token, first_epoch)
        self.commands = Commands(first_epoch, tell)
        self.command_rate = RateLimit(MOST_COMMANDS_S)
        self.links = {
            name: RobotLink(
                len(robot.joints),
                topics.INCREMENT.age_cycles(cell.cycle_s, age_s),
                topics.SERVER_STATE.age_s(cell.cycle_s, age_s),
                max(1, round(cell.max_playout_s / cell.cycle_s)),
                CarriedMotion.of(robot, cell.cycle_s),
                AdmittedAhead(ahead, cell.cycle_s) if ahead > 1 else None,
            )
            for name, robot in cell.robots.items()
        }

    def compare(self, health: Health) -> None:
        """Compare the cell that a service has read with this one's."""
        theirs = CellIdentity.parse(health.cell)
        if self.identity.is_same(theirs):
            self.mismatches.pop(health.service, None)
            return
        self.counters["signs_of_life_of_another_cell"] += 1
        self.mismatches[health.service] = mismatch(health.service, theirs, self.identity)

    def mismatch(self) -> Reason | None:
        """Why nothing moves, where a service has read another cell than this one."""
        for said in self.mismatches.values():
            return Reason(code=ReasonCode.CELL_MISMATCH, what=said)
        return None

    def tick(self, time_s: float) -> list[Output]:
        """End expired leases and commands, and repeat the stops that the gate has not answered."""
        outputs: list[Output] = []
        for lease in self.leases.expired(time_s):
            self.counters["leases_expired"] += 1
            text = f"no message came for {self.cell.lease_s:g} s"
            self.tell_of_lease(AuditKind.LEASE_EXPIRED, lease.origin, lease.robot, text)
            outputs += self._told_of_expiry(lease) + self.holder_lost(lease, time_s)
        late, answers = self.commands.overdue(time_s)
        self.counters["commands_unanswered"] += late
        stops = self.commands.stops_again(time_s)
        self.counters["stops_sent_again"] += len(stops)
        return [*outputs, *answers, *stops]

    def learn_epoch(self, verdict: Verdict) -> list[Output]:
        """If the gate knows a greater epoch than any granted here, end all leases and commands numbered below it."""
        outputs: list[Output] = []
        for reason in verdict.reasons:
            if reason.code is ReasonCode.LEASE_NOT_HELD and reason.bound is not None:
                for lease in self.leases.count_on_from(int(reason.bound)):
                    self.counters["leases_outdated"] += 1
                    text = "the gate knows of a later one"
                    self.tell_of_lease(AuditKind.LEASE_LOST, lease.origin, lease.robot, text)
                    outputs += self.end_lease(lease)
        return outputs

    def refuse(
        self,
        robot: str,
        cycle: int,
        seq: int,
        reason: Reason,
        sender: Sender | None,
        is_holders: bool = True,
    ) -> list[Output]:
        """Refuse an increment: count it, and send the verdict to the sender; the holder's to every watcher too."""
        self.counters["refused"] += 1
        self.counters[f"refused_{reason.code}"] += 1
        if not is_holders:
            origin = ClientOrigin(address="zenoh") if sender is None else sender.origin
            text = EXPLANATIONS[reason.code]
            self.tell(Deed(AuditKind.INCREMENT, AuditOutcome.REFUSED, origin, robot[:64], reason.code, text))
        return refusal(robot, cycle, seq, reason, sender, is_holders)

    def refuse_asked(self, asked: Asked, reason: Reason) -> list[Output]:
        """Refuse a formerly accepted increment."""
        increment = asked.increment
        return self.refuse(increment.robot, increment.cycle, increment.seq, reason, asked.sender)

    def carry(self, asked: Asked, late: Reason) -> list[Output]:
        """Say that an increment came after its turn, and later increments carry its motion."""
        self.counters["carried"] += 1
        increment = asked.increment
        return refusal(
            increment.robot, increment.cycle, increment.seq, late, asked.sender, True, Outcome.CARRIED
        )

    def end_lease(self, lease: Lease) -> list[Output]:
        """End a lease; nothing that was queued under it survives."""
        self.leases.end(lease)
        reason = Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease")
        waited = self.links[lease.robot].end_lease()
        return [output for asked in waited for output in self.refuse_asked(asked, reason)]

    def holder_lost(self, lease: Lease, time_s: float) -> list[Output]:
        """The holder vanished without releasing: stop its robot, if it was used."""
        outputs = self.end_lease(lease)
        moving = self.links[lease.robot].phase(time_s) in (Phase.ENGAGED, Phase.BRAKING)
        if not (moving or lease.used):
            return outputs
        self.counters["controllers_lost"] += 1
        command = self.new_command(kind="stop", robot=lease.robot, reason=ReasonCode.CONTROLLER_LOST)
        return outputs + self.command(command, None, Done(what="stop"), time_s)

    def hold(self, robot: str, time_s: float) -> list[Output]:
        """Order a robot to stop after an unexpected error, and drop its waiting increments.

        It is not ordered again while the gate has not answered.
        """
        reason = Reason(code=ReasonCode.INTERNAL_ERROR)
        outputs = [
            output for asked in self.links[robot].drop() for output in self.refuse_asked(asked, reason)
        ]
        if self.commands.awaits_stop(robot):
            return outputs
        command = self.new_command(kind="stop", robot=robot, reason=ReasonCode.INTERNAL_ERROR)
        return outputs + self.command(command, None, Done(what="stop"), time_s)

    def _told_of_expiry(self, lease: Lease) -> list[Output]:
        if lease.connection is None:
            return []
        bound = f"{self.cell.lease_s:g} s"
        text = f"the lease of {lease.robot} has run out: {lease.client} sent nothing for {bound}"
        renewal = f'{{"type":"lease","robot":"{lease.robot}","action":"renew"}}'
        hint = f"acquire it again, and send any valid line at least every {bound}, e.g. {renewal}"
        error = Error(code=ReasonCode.LEASE_NOT_HELD, message=text, hint=hint, robot=lease.robot)
        return [ToSender(lease.connection, error)]

    def tell_of_lease(self, what: AuditKind, origin: ClientOrigin, robot: str, text: str = "") -> None:
        """Record the end or change of a lease in the audit log."""
        self.tell(Deed(what, AuditOutcome.DONE, origin, robot, text=text))

    def drop_all(self, reason: Reason) -> list[Output]:
        """Refuse every increment that waits, of all robots."""
        dropped = [asked for link in self.links.values() for asked in link.drop()]
        return [output for asked in dropped for output in self.refuse_asked(asked, reason)]

    def new_command(self, **fields: Any) -> Command:
        """A command with these fields, bound to the gate and to the robots' newest states."""
        cycles = {name: link.state.cycle for name, link in self.links.items() if link.state is not None}
        return self.commands.numbered(Command(id=0, cycles=cycles, **fields))

    def command(
        self, command: Command, sender: Sender | None, done: Done | IoReply | None, time_s: float
    ) -> list[Output]:
        """Send a command to the gate and remember the client that gets its answer, `done` or a verdict.

        If a service has read another cell, only a stop is sent.
        """
        if error := self._error_of(command, time_s):
            return self._refused(command, sender, error)
        if command.kind != "dry_run":
            self.tell(deed_of(command, AuditOutcome.ASKED, _origin(sender)))
        self.commands.sent(command, sender, done, time_s)
        return [ToTopic(topics.COMMAND, "", command)]

    def _error_of(self, command: Command, time_s: float) -> Error | None:
        """Why a command does not go to the gate; None if it does."""
        if command.kind == "stop":
            return None
        if self.mismatches:
            code, why = ReasonCode.CELL_MISMATCH, "; ".join(self.mismatches.values())
            hint = "start every service of the cell from the same description"
        elif not self.command_rate.take(time_s):
            self.counters["commands_too_many"] += 1
            code, why = (
                ReasonCode.TOO_MANY,
                f"clients ask for more than {MOST_COMMANDS_S:g} commands a second",
            )
            hint = "ask less often"
        else:
            return None
        message = f"{command.kind} refused: {why}"
        return Error(code=code, message=message, hint=hint, request=command.kind, robot=command.robot)

    def _refused(self, command: Command, sender: Sender | None, error: Error) -> list[Output]:
        self.tell(deed_of(command, AuditOutcome.REFUSED, _origin(sender), error.message, error.code))
        return [] if sender is None else [ToSender(sender, error)]


def _origin(sender: Sender | None) -> ClientOrigin:
    return NOBODY if sender is None else sender.origin
