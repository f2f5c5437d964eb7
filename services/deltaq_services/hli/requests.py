"""Requests of clients besides increments: leases, stops, resets, digital outputs and others.

`ROWS` is the table of all that a client may say. Another request takes a message, a handler and a row here; lines and
zenoh are served from the table, and `deltaq_protocol.topics` has the least role.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.given_token import CLIENT_TOKEN, OPERATOR_TOKEN
from deltaq_protocol.messages import (
    ChallengeRequest,
    ContactRequest,
    DescribeRequest,
    Done,
    DryRunRequest,
    Error,
    Hello,
    Increment,
    IoReply,
    IoRequest,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    Reason,
    ResetRequest,
    StopRequest,
    ToolRequest,
    ViewReply,
    ViewRequest,
    ViewTarget,
    ViewWish,
)
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_protocol.topic import ClientRole, Topic
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.commands import KIND_OF_REQUEST, Deed, deed_of
from deltaq_services.hli.leases import Lease, Sequence
from deltaq_services.hli.state import HliState
from deltaq_services.outputs import ClientOrigin, Output, Sender, ToSender

# Requested views of a camera: their check, and the sum of all requests.

_NOT_ON_A_TOOL = (
    "focus_m: a fixed point of the world, given together with leader or aim_offset_m, a point of a tool"
)
_EACH = "give each target either a `leader`, which may have an `aim_offset_m`, or a `focus_m`"


def problem_of(request: ViewRequest, cell: CellDescription) -> tuple[str, str] | None:
    """Why no follower can use this view, and the remedy; None if one can. The robot is one of the cell's."""
    robot = request.robot
    if cell.robots[robot].camera is None:
        having = [name for name, other in cell.robots.items() if other.camera is not None]
        text = f"robot: {robot} carries no camera; {', '.join(having) or 'no robot of the cell'} does"
        return text, f"give it one under `robots.{robot}.camera` in the cell's YAML"
    others = [name for name in cell.robots if name != robot]
    if request.leader is not None and request.leader not in others:
        text = f"leader: {request.leader!r} is not another robot; {robot} can look at {', '.join(others) or 'nobody'}"
        return text, "name another robot of the cell"
    if request.focus_m is not None and (request.leader is not None or request.aim_offset_m is not None):
        return _NOT_ON_A_TOOL, "give one of the two"
    if request.targets is None:
        return None
    if any(value is not None for value in (request.leader, request.aim_offset_m, request.focus_m)):
        text = "targets: given together with leader, aim_offset_m or focus_m, which they replace"
        return text, "make it one of the targets"
    for place, target in enumerate(request.targets):
        text = _problem_of_target(target, others)
        if text:
            return f"targets.{place}.{text}", _EACH
    return None


def _problem_of_target(target: ViewTarget, others: Iterable[str]) -> str:
    """Why a target is not possible; empty if it is."""
    if target.leader is not None and target.leader not in others:
        return f"leader: {target.leader!r} is not another robot; there are {', '.join(others) or 'none'}"
    if target.focus_m is None:
        return "" if target.leader is not None else "leader: missing, and so is focus_m"
    if target.leader is not None or target.aim_offset_m is not None:
        return _NOT_ON_A_TOOL
    return ""


def changed(before: ViewWish | None, request: ViewRequest) -> ViewWish:
    """The view after a request: omitted values stay; a new target replaces targets of another kind."""
    given = {name: value for name in ViewWish.model_fields if (value := getattr(request, name)) is not None}
    ended: set[str] = set()
    if "targets" in given:
        ended |= {"leader", "aim_offset_m", "focus_m"}
    if given.keys() & {"leader", "aim_offset_m"}:
        ended |= {"focus_m", "targets"}
    if "focus_m" in given:
        ended.add("targets")
    return (before or ViewWish()).model_copy(update={**dict.fromkeys(ended), **given})


_Request = ContactRequest | DryRunRequest | IoRequest | ResetRequest | ToolRequest | ViewRequest
_WithRole = ContactRequest | LeaseRequest | ResetRequest | ViewRequest

_GIVE_IT = f"over lines in the hello; to `deltaq` and in Python by {OPERATOR_TOKEN} or {CLIENT_TOKEN}"


class Requests:
    """Answers requests. A request to the gate is answered when the gate has carried it out.

    Each handler takes the message, its sender and the monotonic time [s], and returns the messages to send.

    Args:
        state: of the HLI.
        roles: determines who may `take`, `reset` and switch contacts, and which clients may have a lease.
    """

    def __init__(self, state: HliState, roles: ClientRoles) -> None:
        self._state = state
        self._roles = roles

    def on_lease(self, request: LeaseRequest, sender: Sender, time_s: float) -> list[Output]:
        """Acquire, renew, release or take the lease of a robot."""
        outputs = self._state.tick(time_s)
        robot, asking = request.robot, replace(sender.origin, client=request.client or "anonymous")
        if robot not in self._state.links:
            self._tell_of_no_lease(request, asking, ReasonCode.UNKNOWN_ROBOT)
            return [*outputs, ToSender(sender, self._lease_reply(robot, ReasonCode.UNKNOWN_ROBOT, time_s))]
        own, current = self._state.leases.held_with(robot, request.lease), self._state.leases.of(robot)
        code: ReasonCode | None = None
        granted: Lease | None = own
        if request.action is LeaseAction.RELEASE:
            if own is None:
                code = ReasonCode.LEASE_NOT_HELD
            else:
                self._state.tell_of_lease(AuditKind.LEASE_RELEASED, own.origin, robot)
                outputs += self._state.end_lease(own)
                granted = None
        elif own is not None:
            self._state.leases.renew(own, time_s)
        elif request.action is LeaseAction.RENEW:
            code = ReasonCode.LEASE_NOT_HELD
        elif self._role(request, sender) < topics.LEASE.least_role(LeaseAction.ACQUIRE):
            code = ReasonCode.NOT_PERMITTED
        elif request.action is LeaseAction.ACQUIRE and current is not None:
            code = ReasonCode.LEASE_TAKEN
        elif self._role(request, sender) < topics.LEASE.least_role(request.action):
            code = ReasonCode.NOT_PERMITTED
        else:
            what, text = AuditKind.LEASE_GRANTED, ""
            if current is not None:
                self._state.counters["leases_taken"] += 1
                what, text = (
                    AuditKind.LEASE_TAKEN_OVER,
                    f"from {current.client}, {current.origin.address or 'unknown'}",
                )
                outputs += self._state.end_lease(current)
            self._state.counters["leases_granted"] += 1
            self._state.tell_of_lease(what, asking, robot, text)
            granted = self._grant(request, asking, sender, time_s)
        if code is not None:
            self._state.counters[f"lease_refused_{code}"] += 1
            self._tell_of_no_lease(request, asking, code)
        return [*outputs, ToSender(sender, self._lease_reply(robot, code, time_s, granted))]

    def _grant(self, request: LeaseRequest, asking: ClientOrigin, sender: Sender, time_s: float) -> Lease:
        connection = sender if sender.lasting else None
        if not request.playout:
            return self._state.leases.grant(request.robot, asking, connection, time_s)
        playout = self._state.links[request.robot].begin_playout()
        overtaking = Sequence(playout.max_cycles)
        return self._state.leases.grant(request.robot, asking, connection, time_s, overtaking)

    def on_stop(self, _: StopRequest, sender: Sender, time_s: float) -> list[Output]:
        """Bring every robot to rest; anyone may."""
        self._state.counters["stops"] += 1
        if (joined := self._state.commands.join_stop(sender)) is not None:
            self._state.tell(deed_of(joined, AuditOutcome.ASKED, sender.origin))
            return []
        outputs = self._state.drop_all(Reason(code=ReasonCode.STOPPED, what=ReasonCode.OPERATOR_STOP))
        command = self._state.new_command(kind="stop", reason=ReasonCode.OPERATOR_STOP)
        return outputs + self._state.command(command, sender, Done(what="stop"), time_s)

    def on_reset(self, request: ResetRequest, sender: Sender, time_s: float) -> list[Output]:
        """End a robot's hold; refused while its cause persists. With an operator's token set, only operators may."""
        if request.robot not in self._state.links:
            return self._error(sender, request, ReasonCode.UNKNOWN_ROBOT, *self._robots_are(request.robot))
        if self._role(request, sender) < topics.RESET.least_role():
            text = f"reset of {request.robot} needs the operator's token"
            return self._error(sender, request, ReasonCode.NOT_PERMITTED, text, _GIVE_IT)
        self._state.counters["resets"] += 1
        command = self._state.new_command(kind="reset", robot=request.robot)
        return self._state.command(command, sender, Done(what=f"reset {request.robot}"), time_s)

    def on_dry_run(self, request: DryRunRequest, sender: Sender, time_s: float) -> list[Output]:
        """Ask the gate for its verdict on an increment in the present state; nothing moves."""
        link = self._state.links.get(request.robot)
        if link is None:
            return self._error(sender, request, ReasonCode.UNKNOWN_ROBOT, *self._robots_are(request.robot))
        if len(request.dq) != link.joints:
            text = f"dq has {len(request.dq)} elements, {request.robot} has {link.joints} joints"
            return self._error(sender, request, ReasonCode.BAD_SHAPE, text, "give one element for each joint")
        self._state.counters["dry_runs"] += 1
        command = self._state.new_command(kind="dry_run", robot=request.robot, dq=request.dq)
        return self._state.command(command, sender, None, time_s)

    def on_contact(self, request: ContactRequest, sender: Sender, time_s: float) -> list[Output]:
        """Allow or forbid a contact. With an operator's token set, only operators may."""
        known = self._state.cell.contacts
        if request.contact not in known:
            text = (
                f"contact: the cell has no contact {request.contact!r}; it has {', '.join(known) or 'none'}"
            )
            return self._error(
                sender, request, ReasonCode.MALFORMED, text, "see `contacts` in the cell's YAML"
            )
        if self._role(request, sender) < topics.CONTACT.least_role():
            text = f"contact {request.contact} needs the operator's token"
            return self._error(sender, request, ReasonCode.NOT_PERMITTED, text, _GIVE_IT)
        self._state.counters["contacts_switched"] += 1
        command = self._state.new_command(
            kind="contact",
            contact=request.contact,
            allowed=request.allowed,
        )
        what = f"contact {request.contact} {'allowed' if request.allowed else 'forbidden'}"
        return self._state.command(command, sender, Done(what=what), time_s)

    def on_view(self, request: ViewRequest, sender: Sender, _time_s: float) -> list[Output]:
        """Request another view of a robot's camera; its states publish it for the follower."""
        link = self._state.links.get(request.robot)
        if link is None:
            return self._error(sender, request, ReasonCode.UNKNOWN_ROBOT, *self._robots_are(request.robot))
        if self._role(request, sender) < topics.VIEW.least_role():
            text = f"another view of {request.robot} needs the controller's token"
            return self._error(sender, request, ReasonCode.NOT_PERMITTED, text, _GIVE_IT)
        problem = problem_of(request, self._state.cell)
        if problem is not None:
            return self._error(sender, request, ReasonCode.MALFORMED, *problem)
        self._state.counters["views_asked"] += 1
        view = link.view = changed(link.view, request)
        told = ", ".join(f"{name} {value}" for name, value in view.model_dump(exclude_none=True).items())
        self._state.tell(Deed(AuditKind.VIEW, AuditOutcome.DONE, sender.origin, request.robot, text=told))
        lease = self._state.leases.of(request.robot)
        holder = lease.client if lease else None
        reply = ViewReply(robot=request.robot, view=view, holder=holder, sight=link.sight, target=link.target)
        return [ToSender(sender, reply)]

    def on_io(self, request: IoRequest, sender: Sender, time_s: float) -> list[Output]:
        """Set digital outputs, and read all of them. While the robot is leased, only the holder may set them."""
        outputs = self._state.tick(time_s)
        robot = request.robot
        if robot not in self._state.links:
            return outputs + self._error(sender, request, ReasonCode.UNKNOWN_ROBOT, *self._robots_are(robot))
        described = self._state.cell.robots[robot]
        changer = described.tool_changer
        if changer is not None and changer.release in request.outputs:
            text = f"outputs: {changer.release} switches the tool changer of {robot}"
            hint = "couple or release a tool: `deltaq io --couple`"
            return outputs + self._error(sender, request, ReasonCode.NOT_PERMITTED, text, hint)
        known = described.outputs
        foreign = [name for name in request.outputs if name not in known]
        if foreign:
            has = ", ".join(known) or "none"
            text = f"outputs: {foreign[0]!r} is not an output of {robot}; it has {has}"
            hint = "see `outputs` in the cell's YAML"
            return outputs + self._error(sender, request, ReasonCode.MALFORMED, text, hint)
        lease = self._state.leases.of(robot)
        if lease is not None and lease.token == request.lease:
            self._state.leases.renew(lease, time_s)
            if request.note:
                self._state.tell(
                    Deed(AuditKind.NOTE, AuditOutcome.DONE, lease.origin, robot, text=request.note)
                )
        elif request.outputs and lease is not None:
            text = f"{lease.client} holds the lease of {robot}: only the holder sets its outputs"
            return outputs + self._error(
                sender, request, ReasonCode.LEASE_NOT_HELD, text, "acquire the lease first"
            )
        elif request.outputs and self._roles.controller_token is not None:
            text = f"outputs of {robot} are set by the holder of its lease, but no client holds it"
            return outputs + self._error(
                sender, request, ReasonCode.LEASE_NOT_HELD, text, "acquire the lease first"
            )
        state = self._state.links[robot].state
        before = state.outputs if state else {}
        reply = IoReply(robot=robot, outputs=before | request.outputs, inputs=state.inputs if state else {})
        if not request.outputs:
            return [*outputs, ToSender(sender, reply)]
        command = self._state.new_command(kind="io", robot=robot, outputs=request.outputs)
        return outputs + self._state.command(command, sender, reply, time_s)

    def on_heard(self, leases: Iterable[tuple[str, str]], time_s: float) -> list[Output]:
        """Renew the leases of a connection that sent a valid message; `leases` are its (robot, token) pairs."""
        outputs = self._state.tick(time_s)
        for robot, token in leases:
            lease = self._state.leases.held_with(robot, token)
            if lease is not None:
                self._state.leases.renew(lease, time_s)
        return outputs

    def on_tool(self, request: ToolRequest, sender: Sender, time_s: float) -> list[Output]:
        """Couple a tool, or release the present one. Only the holder of the robot's lease may."""
        outputs = self._state.tick(time_s)
        robot = request.robot
        if robot not in self._state.links:
            return outputs + self._error(sender, request, ReasonCode.UNKNOWN_ROBOT, *self._robots_are(robot))
        known = self._state.cell.robots[robot].tools
        if not known or request.tool not in {*known, ""}:
            has = ", ".join(known) or "no tool changer"
            text, hint = (
                f"tool: no tool {request.tool!r}; {robot} has {has}",
                "see `tools` in the cell's YAML",
            )
            return outputs + self._error(sender, request, ReasonCode.MALFORMED, text, hint)
        lease = self._state.leases.held_with(robot, request.lease)
        if lease is None:
            text = f"only the holder of the lease of {robot} changes its tool"
            hint = "acquire the lease first"
            return outputs + self._error(sender, request, ReasonCode.LEASE_NOT_HELD, text, hint)
        self._state.leases.renew(lease, time_s)
        self._state.counters["tools_asked"] += 1
        command = self._state.new_command(kind="tool", robot=robot, tool=request.tool)
        what = f"{robot}: {f'couple {request.tool}' if request.tool else 'release the tool'}"
        return outputs + self._state.command(command, sender, Done(what=what), time_s)

    def on_connection_lost(self, leases: Iterable[tuple[str, str]], time_s: float) -> list[Output]:
        """End the leases of a broken connection; `leases` are its (robot, token) pairs."""
        self._state.counters["connections_lost"] += 1
        outputs: list[Output] = []
        for robot, token in leases:
            lease = self._state.leases.held_with(robot, token)
            if lease is not None:
                text = "the connection ended"
                self._state.tell_of_lease(AuditKind.LEASE_LOST, lease.origin, robot, text)
                outputs += self._state.holder_lost(lease, time_s)
        return outputs

    def _lease_reply(
        self, robot: str, code: ReasonCode | None, time_s: float, granted: Lease | None = None
    ) -> LeaseReply:
        current = self._state.leases.of(robot)
        return LeaseReply(
            robot=robot,
            granted=code is None,
            holder=current.client if current else None,
            expires_s=current.expires_s - time_s if current else None,
            lease=granted.token if granted else None,
            code=code,
        )

    def _tell_of_no_lease(self, request: LeaseRequest, asking: ClientOrigin, code: ReasonCode) -> None:
        current = self._state.leases.of(request.robot)
        held = f"; {current.client} holds it" if current else ""
        text = f"{request.action}: {EXPLANATIONS[code]}{held}"
        self._state.tell(
            Deed(AuditKind.LEASE_REFUSED, AuditOutcome.REFUSED, asking, request.robot, code, text)
        )

    def _role(self, request: _WithRole, sender: Sender) -> ClientRole:
        return self._roles.of(request.token, sender.origin.identity)

    def _robots_are(self, robot: str) -> tuple[str, str]:
        return f"the cell has no robot {robot}", "it has " + ", ".join(self._state.links)

    def _error(
        self, sender: Sender, request: _Request, code: ReasonCode, text: str, hint: str
    ) -> list[Output]:
        robot = None if isinstance(request, ContactRequest) else request.robot
        error = Error(code=code, message=text, hint=hint, request=request.type, robot=robot)
        kind = KIND_OF_REQUEST[request.type]
        self._state.tell(Deed(kind, AuditOutcome.REFUSED, sender.origin, robot, code, text))
        return [ToSender(sender, error)]


@dataclass(frozen=True, slots=True)
class RequestRow:
    """One kind of message from a client.

    Attributes:
        model: its message; a line has its `type`.
        topic: its zenoh topic; None if it has none of its own.
        answer: the handler; None: the front or the core takes it itself.
        proven: fields that are replaced by the client's proven values: the robot's `lease`, its `token`,
            and over lines its name, `client`.
    """

    model: type[Message]
    topic: Topic | None = None
    answer: Callable[[Requests, Any, Sender, float], list[Output]] | None = None
    proven: tuple[str, ...] = ()

    @property
    def type(self) -> str:
        """The `type` of its line."""
        return str(self.model.model_fields["type"].default)


ROWS = (
    RequestRow(ChallengeRequest),
    RequestRow(Hello),
    RequestRow(LeaseRequest, topics.LEASE, Requests.on_lease, ("lease", "client", "token")),
    RequestRow(Increment),
    RequestRow(IoRequest, topics.IO, Requests.on_io, ("lease",)),
    RequestRow(StopRequest, topics.STOP, Requests.on_stop),
    RequestRow(ResetRequest, topics.RESET, Requests.on_reset, ("token",)),
    RequestRow(DryRunRequest, topics.DRY_RUN, Requests.on_dry_run),
    RequestRow(ToolRequest, topics.TOOL, Requests.on_tool, ("lease",)),
    RequestRow(ContactRequest, topics.CONTACT, Requests.on_contact, ("token",)),
    RequestRow(ViewRequest, topics.VIEW, Requests.on_view, ("token",)),
    RequestRow(DescribeRequest),
)
"""The table."""

BY_TYPE: Mapping[str, RequestRow] = {row.type: row for row in ROWS}
BY_MODEL: Mapping[type[Message], RequestRow] = {row.model: row for row in ROWS}
