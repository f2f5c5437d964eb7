"""One TCP connection: lines in, lines out, and bounds on both."""

from __future__ import annotations

import asyncio
import socket
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from deltaq_protocol.audit import AuditKind, AuditOutcome
from deltaq_protocol.codec import InvalidMessageError, from_map, line_to_map, to_line
from deltaq_protocol.messages import (
    LINE_VERSIONS,
    PROTOCOL_VERSION,
    Challenge,
    ChallengeRequest,
    DescribeRequest,
    Error,
    Hello,
    Increment,
    LeaseReply,
    Message,
    StopRequest,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.hli.commands import Deed
from deltaq_services.hli.line_encryption import CERTIFICATE_FILE, is_overheard
from deltaq_services.hli.line_requests import MAX_LINE_BYTES, ReceivedLines, hello_of, of_client, request_type
from deltaq_services.hli.newcomers import identity_of
from deltaq_services.hli.state import answered_by_error
from deltaq_services.outputs import ClientOrigin, Output, Sender, ToSender

if TYPE_CHECKING:
    from deltaq_services.hli.shell import Hli
    from deltaq_services.hli.tcp_front import TcpFront

MAX_MALFORMED_IN_A_ROW = 100
MAX_UNREAD_BYTES = 1024 * 1024
"""Greatest size of unread answers; beyond it the connection is closed."""
HELLO_DEADLINE_S = 10.0
CLOSE_DEADLINE_S = 2.0
"""Time for a dismissed client to read the reason."""
STOP_DEADLINE_S = 1.0
"""Time for a stop on a connection beyond the limits."""
_SEND_BUFFER_BYTES = 64 * 1024
"""Approximate size of the kernel's buffer: buffered states cannot be replaced by newer ones."""


class TcpConnection(asyncio.Protocol, Sender):
    """A client over TCP. It holds its leases while it is connected and sends valid messages now and then.

    A client that reads slowly loses old states, never the newest; one that does not read its answers is
    disconnected.

    Args:
        port: to the core.
        front: the server that it belongs to.

    Attributes:
        leases: token of each robot's lease that was granted to this connection.
        origin: its address, and once it has said hello its name and role.
        is_welcome: whether it has sent a valid hello.
    """

    lasting = True
    _transport: asyncio.Transport

    def __init__(self, port: Hli, front: TcpFront) -> None:
        self._port = port
        self._front = front
        self._client: Hello | None = None
        self._lines = ReceivedLines()
        self._malformed_in_a_row = 0
        self._is_slow = False
        self._for_stop_alone = False
        self._address = self._identity = ""
        self._is_overheard = True
        self._newest_states: dict[str, bytes] = {}
        self._hello_deadline: asyncio.TimerHandle | None = None
        self.leases: dict[str, str] = {}

    # --- asyncio.Protocol ---------------------------------------------------------------------------

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """A client has connected."""
        assert isinstance(transport, asyncio.Transport)  # of a TCP server, always
        self._transport = transport
        transport.set_write_buffer_limits(high=_SEND_BUFFER_BYTES)
        sock: socket.socket = transport.get_extra_info("socket")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        self._identity = identity_of(transport)
        peer = transport.get_extra_info("peername")
        self._address = peer[0] if peer else ""
        is_encrypted = transport.get_extra_info("ssl_object") is not None
        self._is_overheard = is_overheard(self._address, is_encrypted)
        self.origin = self._origin(None, address_of(transport))
        self._for_stop_alone = not self._front.admit(self, self._address, is_encrypted)
        if self._for_stop_alone:
            self._port.loop.call_later(STOP_DEADLINE_S, self.close)
            return
        self._hello_deadline = self._port.loop.call_later(HELLO_DEADLINE_S, self._hello_is_overdue)

    def data_received(self, data: bytes) -> None:
        """Take received bytes."""
        begin = len(self._lines)
        self._lines.add(data)
        if self._lines.take_stop(begin):
            take, robots = self._port.core.take, self._port.core.description.robots
            self._port.serve(lambda: take(StopRequest(), self._port.now(), self), robots, self)
        if self._for_stop_alone:
            self._lines.forget_whole()
            if len(self._lines) > MAX_LINE_BYTES:  # the partial line is too long for a stop
                self.close()
        elif self._has_line():
            self._front.wants_turn(self)

    def pause_writing(self) -> None:
        """The client reads more slowly than the server writes."""
        self._is_slow = True

    def resume_writing(self) -> None:
        """The client has caught up: send the newest of the missed states."""
        self._is_slow = False
        while self._newest_states and not self._is_slow:
            robot = next(iter(self._newest_states))
            self._transport.write(self._newest_states.pop(robot))

    @property
    def is_welcome(self) -> bool:
        """Whether it has sent a valid hello."""
        return self._client is not None

    def connection_lost(self, _exc: Exception | None) -> None:
        """The connection has broken or was closed."""
        if self._hello_deadline is not None:
            self._hello_deadline.cancel()
        self._front.leave(self)

    # --- out ----------------------------------------------------------------------------------------

    def deliver(self, message: Message) -> None:
        """Send a message; the token of a lease stays here, the connection is the holder."""
        if isinstance(message, LeaseReply):
            self._note_lease(message)
            message = message.model_copy(update={"lease": None})
        if self._transport.is_closing():
            return
        is_description = message is self._port.core.description
        self._transport.write(self._front.description_line if is_description else to_line(message))
        if self._transport.get_write_buffer_size() > MAX_UNREAD_BYTES:
            self._front.counters["tcp_not_reading"] += 1
            self._tell(AuditKind.DISCONNECTED, ReasonCode.TOO_MANY, "the answers were not read")
            self._transport.abort()

    def deliver_state(self, robot: str, line: bytes) -> None:
        """Send a state, or keep it as the newest until the client has caught up."""
        if self._client is None or self._transport.is_closing():
            return
        if self._is_slow:
            if robot in self._newest_states:
                self._front.counters["tcp_states_skipped"] += 1
            self._newest_states[robot] = line
        else:
            self._transport.write(line)

    def close(self) -> None:
        """Close the connection when everything has been sent, or could have been."""
        self._transport.close()
        self._port.loop.call_later(CLOSE_DEADLINE_S, self._transport.abort)

    # --- in -----------------------------------------------------------------------------------------

    def serve_line(self) -> bool:
        """Serve the waiting line; returns whether another one waits."""
        if self._transport.is_closing():
            return False
        line = self._lines.take()
        if line is not None:
            self._serve(line)
        return self._has_line()

    def _has_line(self) -> bool:
        """Whether a whole line waits; a line without an end that is too long ends the connection."""
        if self._transport.is_closing():
            return False
        length, is_whole = self._lines.first()
        if length > MAX_LINE_BYTES:
            text = f"a line of {length} bytes or more; at most {MAX_LINE_BYTES} are allowed"
            self._give_up(text, "end every message with a newline")
            return False
        # unread data in the system's buffers delays only its sender
        if is_whole and len(self._lines) > MAX_LINE_BYTES:
            self._transport.pause_reading()
        else:
            self._transport.resume_reading()
        return is_whole

    def _serve(self, line: bytes) -> None:
        data: dict[str, Any] = {}
        self._port.serve(lambda: self._judged(line, data), tuple(self.leases), self, data)
        if self._malformed_in_a_row >= MAX_MALFORMED_IN_A_ROW:
            text = f"{MAX_MALFORMED_IN_A_ROW} malformed lines in a row"
            self._give_up(text, "send one JSON object a line; `deltaq schema` prints their schema")

    def _judged(self, line: bytes, data: dict[str, Any]) -> list[Output]:
        """What comes of a line, which is read into `data`."""
        core, now = self._port.core, self._port.now()
        try:
            data.update(line_to_map(line))
            outputs = self._outputs(data, now)
        except InvalidMessageError as error:
            self._malformed_in_a_row += 1
            return core.increments.on_malformed(error, self)
        self._malformed_in_a_row = 0
        return outputs + core.requests.on_heard(self.leases.items(), now)

    def _outputs(self, data: dict[str, Any], now: float) -> list[Output]:
        core = self._port.core
        message_type = request_type(data)
        if message_type is Hello:
            return self._greet(hello_of(data))
        if message_type is StopRequest:
            # any client may stop, and a stop is obeyed whatever its other fields are
            return core.take(StopRequest(), now, self)
        if message_type is ChallengeRequest:
            return self._told(Challenge(challenge=self._port.authentication.challenge(now).hex()))
        client = self._client
        if client is None:
            text = f"{data['type']} before the hello"
            hint = f'begin with {{"type":"hello","protocol":{PROTOCOL_VERSION},"client":"your name"}}'
            answered = answered_by_error(data)
            self._tell(AuditKind.MESSAGE, ReasonCode.NOT_PERMITTED, text)
            return self._told(Error(code=ReasonCode.NOT_PERMITTED, message=text, hint=hint, **answered))
        if message_type is Increment:
            return self._increment(data, now)
        request = from_map(message_type, data)
        if isinstance(request, DescribeRequest):
            return self._told(core.description)
        return core.take(of_client(request, client, self.leases), now, self)

    def _greet(self, said: Hello) -> list[Output]:
        if said.token is not None and self._is_overheard:
            self._front.counters["tokens_in_clear"] += 1
            text = "`token` came over a network without TLS, where others can read it; the connection ends"
            hint = (
                "ask for a `challenge` and prove the token in the hello, by `challenge` and `proof`; or give the HLI a "
                f"certificate ({CERTIFICATE_FILE}). Draw a new token: this one may be known"
            )
            return self._turn_away(said, text, hint)
        hello = self._front.proven(said, self._address)
        if hello is None:
            text = "wrong token, or too many wrong ones came from this address; the connection ends"
            hint = "give the right one a second later, or none: then you may watch, and stop"
            return self._turn_away(said, text, hint)
        self.origin = self._origin(hello, self.origin.address)
        outputs = self._port.core.take(hello, self._port.now(), self)
        self._port.serve(lambda: outputs)
        if hello.protocol not in LINE_VERSIONS:
            self.close()
        else:
            self._client = hello
            if self._hello_deadline is not None:
                self._hello_deadline.cancel()
        return []

    def _turn_away(self, said: Hello, text: str, hint: str) -> list[Output]:
        self.origin = replace(self.origin, client=said.client)
        self._tell(AuditKind.CONNECTED, ReasonCode.NOT_PERMITTED, text)
        self.deliver(Error(code=ReasonCode.NOT_PERMITTED, message=text, hint=hint, request=said.type))
        self.close()
        return []

    def _increment(self, data: dict[str, Any], now: float) -> list[Output]:
        """The connection is the holder: a lease that the line names is ignored."""
        robot = data.get("robot")
        data["lease"] = self.leases.get(robot) if isinstance(robot, str) else None
        try:
            return self._port.core.take(from_map(Increment, data), now, self)
        except InvalidMessageError as error:
            if error.code is ReasonCode.MALFORMED:
                raise
            return self._port.core.take(error, now, self)

    def _note_lease(self, reply: LeaseReply) -> None:
        if reply.granted and reply.lease is not None:
            self.leases[reply.robot] = reply.lease
        elif reply.granted:
            self.leases.pop(reply.robot, None)

    def _told(self, message: Message) -> list[Output]:
        return [ToSender(self, message)]

    def _origin(self, hello: Hello | None, address: str) -> ClientOrigin:
        role = self._port.roles.of(hello.token if hello else None, self._identity)
        return ClientOrigin(hello.client if hello else "", address, role.name.lower(), self._identity)

    def _tell(self, what: AuditKind, code: ReasonCode, text: str) -> None:
        self._port.core.tell(Deed(what, AuditOutcome.REFUSED, self.origin, code=code, text=text))

    def _give_up(self, text: str, hint: str) -> None:
        self._front.counters["tcp_given_up"] += 1
        self._tell(AuditKind.DISCONNECTED, ReasonCode.MALFORMED, text)
        self.deliver(Error(code=ReasonCode.MALFORMED, message=f"{text}; the connection ends", hint=hint))
        self.close()

    def _hello_is_overdue(self) -> None:
        self._give_up(f"no hello within {HELLO_DEADLINE_S:g} s", "the first line of a client is its hello")


def address_of(transport: asyncio.BaseTransport) -> str:
    """HOST:PORT of the other end."""
    peer = transport.get_extra_info("peername")
    if not peer:
        return ""
    host = f"[{peer[0]}]" if ":" in peer[0] else peer[0]
    return f"{host}:{peer[1]}"
