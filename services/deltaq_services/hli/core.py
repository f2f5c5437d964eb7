"""The core of the HLI: pure; its shell passes the time.

Between controllers and gate it keeps the leases (`leases`), passes on the newest increment of each cycle
(`increments`), and answers requests (`requests`), refusals with their reason.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import MappingProxyType

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.guarded import CommandReply, Health, ServerState
from deltaq_protocol.identity import CellIdentity
from deltaq_protocol.messages import (
    LINE_VERSIONS,
    Description,
    Error,
    Hello,
    Increment,
    LeaseStatus,
    Message,
    Proximity,
    RobotState,
    RobotStatus,
    Status,
    ToolPose,
    Verdict,
    Welcome,
)
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_services.containment import Containment, Part
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.commands import Deed, Tell, told_to_nobody
from deltaq_services.hli.increments import Increments
from deltaq_services.hli.leases import Leases
from deltaq_services.hli.requests import BY_MODEL, Requests
from deltaq_services.hli.robot_link import RobotLink
from deltaq_services.hli.state import HliState, answered_by_error
from deltaq_services.outputs import Output, Sender, ToSender, ToTopic
from deltaq_services.rate_limit import Heard, Pace


class HliCore(Part):
    """All decisions of the HLI; each `on_...` method returns the messages to send.

    Args:
        cell: description of the cell.
        description: the cell's description for clients.
        tool_pose: pose of a robot's tool from its name, its n joints `q` [rad or m], and the coupled tool, if any.
        new_token: makes a secret, different each time.
        first_epoch: greater than any lease epoch or command id used before, as far as that can be known.
        roles: of clients; None: every client is an operator.
        tell: takes actions, for the audit log.

    Attributes:
        increments: takes the controllers' increments.
        requests: answers leases, stop, reset and digital outputs.
        counters: everything that has been counted.
        tell: as given.
        containment: of unexpected errors.
    """

    aside = frozenset({"increments", "requests"})

    def __init__(
        self,
        cell: CellDescription,
        description: Description,
        tool_pose: Callable[..., ToolPose],
        new_token: Callable[[], str],
        first_epoch: int,
        roles: ClientRoles | None = None,
        tell: Tell = told_to_nobody,
    ) -> None:
        self.tell = tell
        identity = CellIdentity.parse(description.identity)
        self._state = HliState(cell, identity, new_token, first_epoch, tell)
        self._tool_pose = tool_pose
        self._gate: Health | None = None
        self._gate_heard_s = -math.inf
        bound_s = cell.gate.max_request_age_s
        self._states = {name: Heard(name, topics.SERVER_STATE, cell.cycle_s, bound_s) for name in cell.robots}
        services = ("sim", *(f"robot-server-{name}" for name in cell.robots))
        self._services = {name: Heard(name, topics.HEALTH, cell.cycle_s) for name in services}
        self._proximity = Pace(topics.PROXIMITY.period_s(cell.cycle_s))
        self.description = description
        self.counters = self._state.counters
        self.increments = Increments(self._state)
        self.requests = Requests(self._state, roles or ClientRoles())
        self.containment = Containment()

    def contained(
        self,
        decide: Callable[[], list[Output]],
        time_s: float,
        robots: Iterable[str] = (),
        sender: Sender | None = None,
        asked: Mapping[str, object] = MappingProxyType({}),
    ) -> list[Output]:
        """The result of `decide`. An unexpected error is reported, and the robots are held; nothing else changes.

        Args:
            decide: decides on one message.
            time_s: when it came.
            robots: the robots that it concerns; to be held if it fails.
            sender: the client that gets an error if it fails.
            asked: the message as it came, as far as it could be read.
        """
        self.containment.remember(self._parts())
        try:
            return decide()
        except Exception as error:
            self.containment.put_back()
            self.failed(error)
        outputs: list[Output] = []
        for robot in robots:
            outputs += self._state.hold(robot, time_s)
        if sender is not None:
            code = ReasonCode.INTERNAL_ERROR
            told = Error(
                code=code, message=EXPLANATIONS[code], hint="see the HLI's log", **answered_by_error(asked)
            )
            outputs.append(ToSender(sender, told))
        return outputs

    def failed(self, error: Exception) -> None:
        """Count and log an unexpected error."""
        self.containment.note(error)
        self.counters["internal_errors"] += 1

    def _parts(self) -> Iterator[object]:
        """The objects that change."""
        state = self._state
        yield from (self, state, state.commands, state.command_rate, self._proximity, *state.leases.parts)
        for link in state.links.values():
            yield from link.parts

    def take(
        self, message: Message | InvalidMessageError, time_s: float, sender: Sender | None = None
    ) -> list[Output]:
        """Take a message from a service or from a client.

        Args:
            message: a message, or why an increment is none.
            time_s: when it came.
            sender: the client to answer; only an increment may have none: every watcher gets its verdict.

        Raises:
            TypeError: for a message of a type that is not sent here.
        """
        match message:
            case ServerState():
                return self.on_server_state(message, time_s)
            case Verdict():
                return self.on_gate_verdict(message)
            case CommandReply():
                return self.on_command_reply(message)
            case Health():
                return self.on_health(message, time_s)
            case Increment():
                return self.increments.on_increment(message, sender, time_s)
            case InvalidMessageError():
                return self.increments.on_bad_increment(message, sender, time_s)
        if sender is None:
            raise TypeError(f"a {type(message).__name__} needs an answer, but has no sender")
        if isinstance(message, Hello):
            return self.on_hello(message, sender)
        row = BY_MODEL.get(type(message))
        if row is not None and row.answer is not None:
            return row.answer(self.requests, message, sender, time_s)
        raise TypeError(
            f"the HLI takes states, verdicts, replies and requests, got a {type(message).__name__}"
        )

    def on_server_state(self, state: ServerState, time_s: float) -> list[Output]:
        """A cycle of a robot: send the waiting increment to the gate, and the state to the controllers.

        The heartbeat for the gate comes last: the controllers' time to answer has begun.
        """
        link = self._state.links.get(state.robot)
        if link is None or len(state.q) != link.joints:
            self.counters["states_ignored"] += 1
            return []
        self.counters["states"] += 1
        self._states[state.robot].at(time_s)
        if state.tool != self.description.coupled.get(state.robot):
            coupled = {**self.description.coupled, state.robot: state.tool}
            self.description = self.description.model_copy(update={"coupled": coupled})
        outputs = self._state.tick(time_s)
        link.take_state(state, time_s)
        self._state.commands.suppose(state.epoch)
        waited = link.waits
        playout = None if link.playout is None else link.playout.told()
        asked = self.increments.on_cycle(state.robot, link, time_s)
        q_ahead, setpoint_cycle = link.told_ahead()
        placed = RobotState(
            robot=state.robot,
            cycle=state.cycle,
            ipoc=state.ipoc,
            time_s=state.time_s,
            q=state.q,
            q_cmd=state.q_cmd,
            tool=self._tool_pose(state.robot, state.q, *((state.tool,) if state.tool else ())),
            phase=state.phase,
            reason=state.reason,
            gate=self._gate.fingerprint if self._gate else "",
            q_ahead=q_ahead,
            setpoint_cycle=setpoint_cycle,
            playout=playout,
            sight=link.sight,
            target=link.target,
            view=link.view,
            coupled=state.tool,
        )
        told = ToTopic(topics.STATE, state.robot, placed)
        return [*outputs, *asked, told] if waited else [*outputs, told, *asked]

    def on_gate_verdict(self, verdict: Verdict) -> list[Output]:
        """Take a verdict of the gate, and send it to the sender and every watcher."""
        link = self._state.links.get(verdict.robot)
        if link is None:
            self.counters["verdicts_ignored"] += 1
            return []
        self.counters[f"verdicts_{verdict.outcome}"] += 1
        awaited, sender = link.decided(verdict)
        lease = self._state.leases.of(verdict.robot)
        if not awaited and lease is not None:
            sender = lease.connection
        outputs: list[Output] = [ToTopic(topics.VERDICT, verdict.robot, verdict)]
        if sender is not None:
            outputs.insert(0, ToSender(sender, verdict))
        return outputs + self._state.learn_epoch(verdict)

    def on_command_reply(self, reply: CommandReply) -> list[Output]:
        """Take the gate's answer to a command."""
        return self._state.commands.answered(reply)

    def on_health(self, health: Health, time_s: float) -> list[Output]:
        """Take a service's heartbeat; the gate's contains its counters and the nearest pair."""
        if health.service in self._services:
            self._services[health.service].at(time_s)
            self._state.compare(health)
        if health.service != "sim":
            return []
        self._gate, self._gate_heard_s = health, time_s
        if health.epoch is not None:
            self._state.commands.learn(health.epoch, health.newest_id or 0)
        if health.nearest is None or not self._proximity.due(time_s):
            return []
        return [ToTopic(topics.PROXIMITY, "", Proximity(time_s=health.time_s, pairs=(health.nearest,)))]

    def on_hello(self, hello: Hello, sender: Sender) -> list[Output]:
        """Answer a hello: welcome the client, or refuse another protocol version."""
        if hello.protocol not in LINE_VERSIONS:
            self.counters["version_mismatches"] += 1
            ours = ", ".join(map(str, LINE_VERSIONS))
            text = f"client speaks protocol {hello.protocol}, this server {ours}"
            hint = "install the deltaq version that the server runs"
            self.tell(
                Deed(
                    AuditKind.CONNECTED,
                    AuditOutcome.REFUSED,
                    sender.origin,
                    code=ReasonCode.PROTOCOL_VERSION,
                    text=text,
                )
            )
            error = Error(code=ReasonCode.PROTOCOL_VERSION, message=text, hint=hint, request=hello.type)
            return [ToSender(sender, error)]
        self.tell(Deed(AuditKind.CONNECTED, AuditOutcome.DONE, sender.origin))
        description = self.description
        welcome = Welcome(
            protocol=hello.protocol,
            cell=description.cell,
            cycle_s=description.cycle_s,
            robots=description.robots,
            identity=description.identity,
        )
        return [ToSender(sender, welcome)]

    def on_tick(self, time_s: float) -> list[Output]:
        """Let leases and commands run out."""
        return self._state.tick(time_s)

    def gate_age_s(self, time_s: float) -> float | None:
        """Time since the gate's last message [s]; None if there was none."""
        return time_s - self._gate_heard_s if self._gate else None

    def status(self, time_s: float, front_counters: Counter[str]) -> Status:
        """The running cell; `front_counters` are the fronts' own counters."""
        gate = self._gate
        return Status(
            cell=self._state.cell.cell,
            robots={
                robot: self._robot_status(robot, link, time_s) for robot, link in self._state.links.items()
            },
            gate=gate.counters if gate else {},
            gate_age_s=self.gate_age_s(time_s),
            gate_fingerprint=gate.fingerprint if gate else "",
            contacts=gate.contacts if gate else (),
            hli=dict(self.counters + front_counters),
            nearest=gate.nearest if gate else None,
            lagging=self.lagging(time_s),
            identity=self.description.identity,
            mismatches=self.mismatches,
        )

    @property
    def leases(self) -> Leases:
        """The leases of all robots."""
        return self._state.leases

    @property
    def mismatches(self) -> tuple[str, ...]:
        """Services that have read another cell than this one, as text."""
        return tuple(self._state.mismatches.values())

    def lagging(self, time_s: float) -> tuple[str, ...]:
        """Streams that are silent, or slower than the table of topics requires, as text."""
        faults = (stream.fault(time_s) for stream in self._streams())
        return tuple(fault for fault in faults if fault is not None)

    def _streams(self) -> tuple[Heard, ...]:
        return *self._states.values(), *self._services.values()

    def _robot_status(self, robot: str, link: RobotLink, time_s: float) -> RobotStatus:
        state, lease = link.state, self._state.leases.of(robot)
        return RobotStatus(
            phase=link.phase(time_s),
            reason=state.reason if state else None,
            cycle=state.cycle if state else 0,
            state_age_s=time_s - link.received_s if state else None,
            q=state.q if state else (),
            lease=LeaseStatus(
                holder=lease.client if lease else None,
                expires_s=lease.expires_s - time_s if lease else None,
                epoch=lease.epoch if lease else 0,
            ),
            counters=state.counters if state else {},
            lag_s=state.lag_s if state else (),
        )
