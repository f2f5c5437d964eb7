"""Commands to the gate that await their answer, and actions for the audit log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from deltaq_protocol import topics
from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.guarded import Command, CommandReply
from deltaq_protocol.messages import MOST_COUNTED_ON, DryRunReply, Error, Message
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_services.containment import Part
from deltaq_services.outputs import NOBODY, ClientOrigin, Output, Sender, ToSender, ToTopic


@dataclass(frozen=True, slots=True)
class Deed:
    """One action, done or attempted, for the audit log.

    Attributes:
        what: the kind of action.
        outcome: its result so far.
        origin: the client that did it.
        robot: the robot that it concerned; None for no robot or all robots.
        code: why it was refused.
        text: the answer to the client.
    """

    what: AuditKind
    outcome: AuditOutcome
    origin: ClientOrigin
    robot: str | None = None
    code: ReasonCode | None = None
    text: str = ""


Tell = Callable[[Deed], None]
"""Takes actions for the audit log."""

KIND_OF_REQUEST = {
    "stop": AuditKind.STOP,
    "reset": AuditKind.RESET,
    "io": AuditKind.OUTPUTS,
    "contact": AuditKind.CONTACT,
    "tool": AuditKind.TOOL,
    "dry_run": AuditKind.DRY_RUN,
    "view": AuditKind.VIEW,
}
"""By the type of the request, which is the kind of the command that comes of it."""


def told_to_nobody(_deed: Deed) -> None:
    """Takes the actions of a core without an audit log, and drops them."""


def deed_of(
    command: Command,
    outcome: AuditOutcome,
    origin: ClientOrigin,
    text: str = "",
    code: ReasonCode | None = None,
) -> Deed:
    """The outcome of a command to the gate; without a text, the command's request."""
    kind = KIND_OF_REQUEST[command.kind]
    return Deed(kind, outcome, origin, command.robot, code, text or _asked_for(command))


def _asked_for(command: Command) -> str:
    match command.kind:
        case "stop":
            return f"{command.robot or 'every robot'}: {command.reason}"
        case "io":
            return ", ".join(f"{name} {'on' if on else 'off'}" for name, on in command.outputs.items())
        case "contact":
            return f"{command.contact} {'allowed' if command.allowed else 'forbidden'}"
        case "tool":
            return f"couple {command.tool}" if command.tool else "release the tool"
    return ""


REPLY_DEADLINE_S = 0.5
"""Silence of the gate after which a command counts as not confirmed."""

MOST_AWAIT_A_STOP = 64
"""Greatest number of clients that wait for one stop; a further client sends a stop of its own."""

STOP_PERIOD_S = 0.1
"""A stop that the gate has not answered is sent again after this: a session that broke carries nothing, and does not
say so. The gate takes a stop as often as it comes."""

_HINTS = {
    ReasonCode.CAUSE_STANDS: "remove the cause, then reset again",
    ReasonCode.NOT_AT_REST: "wait until the robot is at rest, then reset again",
}


_WITHOUT_GATE = "without the gate every robot brakes to rest by itself; see `deltaq status`"
_HINTS_UNCONFIRMED = {
    "stop": "it was sent, and every process that receives it obeys; " + _WITHOUT_GATE,
    "reset": "it was sent, and may still be carried out; see `deltaq status`",
}


def _unconfirmed(command: Command) -> str:
    match command.kind:
        case "stop":
            what = f" that {command.robot or 'every robot'} is held"
        case "reset":
            what = f" that {command.robot or 'every robot'} is reset"
        case _:
            what = ""
    return f"{command.kind} is not confirmed: the gate did not answer within {REPLY_DEADLINE_S:g} s{what}"


@dataclass(frozen=True, slots=True)
class _Stop:
    """A stop that the gate has not answered, and when it is sent again."""

    command: Command
    again_s: float


@dataclass(frozen=True, slots=True)
class _Awaited:
    command: Command
    senders: tuple[Sender, ...]
    done: Message | None
    deadline_s: float

    @property
    def origins(self) -> tuple[ClientOrigin, ...]:
        """The clients that asked for it; empty for a command of the HLI itself."""
        return tuple(sender.origin for sender in self.senders) or (NOBODY,)


def _told(awaited: _Awaited, message: Message) -> list[Output]:
    return [ToSender(sender, message) for sender in awaited.senders]


class Commands(Part):
    """The commands that await the gate's answer.

    The gate's heartbeats carry its epoch and the ids that an earlier process used, so that the first command is
    valid. A gate that was restarted since refuses the command, and its refusal carries them.

    Args:
        first_id: greater than any id used before, as far as that can be known.
        tell: takes the result of each, for the audit log.
    """

    def __init__(self, first_id: int, tell: Tell = told_to_nobody) -> None:
        self._tell = tell
        self._id = first_id
        self._epoch = 0
        self._outdated_id = 0
        self._stop_id = 0
        self._awaited: dict[int, _Awaited] = {}
        self._stops: dict[str | None, _Stop] = {}  # the newest of each robot, and of all robots

    def numbered(self, command: Command) -> Command:
        """A command for the known gate, with an unused id."""
        self._id += 1
        if command.kind == "stop":
            self._stop_id = self._id
        return command.model_copy(update={"id": self._id, "epoch": self._epoch})

    def sent(self, command: Command, sender: Sender | None, done: Message | None, time_s: float) -> None:
        """Await the answer to a command; `done`, if any, goes to the sender when it was carried out."""
        senders = () if sender is None else (sender,)
        self._awaited[command.id] = _Awaited(command, senders, done, time_s + REPLY_DEADLINE_S)
        if command.kind == "stop":
            self._stops[command.robot] = _Stop(command, time_s + STOP_PERIOD_S)

    def awaits_stop(self, robot: str) -> bool:
        """Whether a stop of this robot has not been answered yet."""
        return any(
            one.command.kind == "stop" and one.command.robot == robot for one in self._awaited.values()
        )

    def join_stop(self, sender: Sender) -> Command | None:
        """Let one more await the stop of all robots that is under way; returns it, if there is one and not too many do.

        However fast stops come, no more of them go to the gate than it answers. One that was asked for after a reset
        joins none from before it.
        """
        for id, awaited in self._awaited.items():
            if id == self._id and awaited.command.kind == "stop" and not awaited.command.robot:
                if len(awaited.senders) >= MOST_AWAIT_A_STOP:
                    return None
                self._awaited[id] = replace(awaited, senders=(*awaited.senders, sender))
                return awaited.command
        return None

    def stops_again(self, time_s: float) -> list[Output]:
        """The stops that the gate has not answered yet, even if their senders already got an outcome."""
        again = [stop for stop in self._stops.values() if time_s >= stop.again_s]
        for stop in again:
            self._stops[stop.command.robot] = replace(stop, again_s=time_s + STOP_PERIOD_S)
        return [ToTopic(topics.COMMAND, "", stop.command) for stop in again]

    def answered(self, reply: CommandReply) -> list[Output]:
        """Answer the sender of the command, or send the command again as the gate requires."""
        self._stops = {robot: stop for robot, stop in self._stops.items() if stop.command.id != reply.id}
        asked = self._awaited.get(reply.id)
        if asked is not None and reply.epoch is not None and reply.newest_id is not None:
            self.learn(reply.epoch, reply.newest_id)
            unknowing = asked.command.epoch != reply.epoch or asked.command.id <= self._outdated_id
            # commands from before a stop must not come after it
            if unknowing and asked.command.id > self._stop_id:
                return self._sent_again(self._awaited.pop(reply.id))
            if not unknowing and reply.code is ReasonCode.REPLAYED_SEQUENCE:
                return []  # a duplicate; the answer to the first is still to come
        awaited = self._awaited.pop(reply.id, None)
        if awaited is None:
            return []
        if reply.verdict is not None:
            return _told(awaited, DryRunReply(robot=reply.verdict.robot, verdict=reply.verdict))
        if reply.accepted and awaited.done is not None:
            self._say(awaited, AuditOutcome.DONE)
            return _told(awaited, awaited.done)
        code = reply.code or ReasonCode.NOT_PERMITTED
        asked_for = awaited.command.robot
        robot = f" of {asked_for}" if asked_for else ""
        text = f"{awaited.command.kind}{robot} refused: {reply.message or EXPLANATIONS[code]}"
        hint = _HINTS.get(code, "") if awaited.command.kind == "reset" else ""
        self._say(awaited, AuditOutcome.REFUSED, text, code)
        error = Error(
            code=code, message=text, hint=hint, request=awaited.command.kind, robot=asked_for or None
        )
        return _told(awaited, error)

    def suppose(self, epoch: int) -> None:
        """Note the gate's epoch from a Robot Server (0: none yet); the gate's own messages take precedence."""
        self._epoch = self._epoch or epoch

    def learn(self, epoch: int, newest_id: int) -> None:
        """Note epoch and newest id from the gate."""
        self._epoch = epoch
        if self._id < newest_id < MOST_COUNTED_ON:
            self._outdated_id, self._id = self._id, newest_id

    def _sent_again(self, awaited: _Awaited) -> list[Output]:
        command = self.numbered(awaited.command)
        self._awaited[command.id] = replace(awaited, command=command)
        return [ToTopic(topics.COMMAND, "", command)]

    def _say(
        self, awaited: _Awaited, outcome: AuditOutcome, text: str = "", code: ReasonCode | None = None
    ) -> None:
        for origin in awaited.origins:
            self._tell(deed_of(awaited.command, outcome, origin, text, code))

    def overdue(self, time_s: float) -> tuple[int, list[Output]]:
        """How many commands the gate has just left unanswered, and the errors for their senders."""
        late = [awaited for awaited in self._awaited.values() if time_s >= awaited.deadline_s]
        for awaited in late:
            del self._awaited[awaited.command.id]
            self._say(
                awaited, AuditOutcome.UNCONFIRMED, _unconfirmed(awaited.command), ReasonCode.UNREACHABLE
            )
        answers = [
            told
            for awaited in late
            for told in _told(
                awaited,
                Error(
                    code=ReasonCode.UNREACHABLE,
                    message=_unconfirmed(awaited.command),
                    hint=_HINTS_UNCONFIRMED.get(awaited.command.kind, _WITHOUT_GATE),
                    request=awaited.command.kind,
                    robot=awaited.command.robot or None,
                ),
            )
        ]
        return len(late), answers
