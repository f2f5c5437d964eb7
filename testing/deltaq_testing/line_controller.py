"""A controller that is a program of its own and speaks JSON lines, in virtual time."""

import socket
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from deltaq_protocol.codec import MAX_MESSAGE_BYTES, InvalidMessageError, from_map, line_to_map, to_line
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Increment, LeaseReply, LeaseRequest, Message, RobotState
from deltaq_services.hli.line_requests import request_type
from deltaq_testing.faults.catalogue import Misbehaviour
from deltaq_testing.faults.controller import increment_of, misbehaved
from deltaq_testing.virtual_cell.clients import Say

PATIENCE_S = 10.0
"""Time for a program to connect, and to answer a state; virtual time waits for it."""
_SHOWN = (
    "a controller in virtual time answers every state with one line, an increment or the renewal of its lease"
)


class ControllerProcessError(DeltaqError):
    """The program under test cannot be started, or does not answer."""


class ControllerProcess:
    """Starts a program, and carries lines to it and from it.

    Args:
        command: the program and its arguments; `{port}` stands for the port to connect to.
        folder: its working folder; None for the present one.
        patience_s: how long it is waited for.

    Raises:
        ControllerProcessError: there is no command.
    """

    def __init__(
        self, command: Sequence[str], folder: Path | None = None, patience_s: float = PATIENCE_S
    ) -> None:
        if not command:
            raise ControllerProcessError("command must name a program, got an empty list")
        self._server = socket.create_server(("127.0.0.1", 0))
        port = self._server.getsockname()[1]
        self._command = [str(word).replace("{port}", str(port)) for word in command]
        self._folder, self._patience_s = folder, patience_s
        self._program: subprocess.Popen[bytes] | None = None
        self._connection: socket.socket | None = None
        self._received = bytearray()

    def start(self) -> None:
        """Start or restart the program, and wait until it has connected.

        Raises:
            ControllerProcessError: it cannot be started, ends, or does not connect.
        """
        self.end()
        try:
            self._program = subprocess.Popen(self._command, cwd=self._folder)
        except OSError as error:
            raise ControllerProcessError(f"{self._command[0]} cannot be started: {error.strerror}") from None
        self._server.settimeout(self._patience_s)
        try:
            self._connection, _ = self._server.accept()
        except TimeoutError:
            raise ControllerProcessError(
                f"{self._name} did not connect within {self._patience_s:g} s: {self._fate()}; `{{port}}` in its "
                "command stands for the port"
            ) from None
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection.settimeout(self._patience_s)

    def say(self, line: bytes) -> None:
        """Send a line; it is lost if the program has ended."""
        if self._connection is not None:
            with suppress(OSError):
                self._connection.sendall(line)

    def hear(self, awaited: str) -> bytes | None:
        """Wait for the next line; None if the program has closed its end.

        Args:
            awaited: the expected message, for the error.

        Raises:
            ControllerProcessError: none came in time, or it does not end.
        """
        while (end := self._received.find(b"\n")) < 0:
            if len(self._received) > MAX_MESSAGE_BYTES:
                raise ControllerProcessError(
                    f"{self._name}: a line must not be longer than {MAX_MESSAGE_BYTES} bytes"
                )
            try:
                data = b"" if self._connection is None else self._connection.recv(65536)
            except TimeoutError:
                raise ControllerProcessError(
                    f"{self._name} said nothing for {self._patience_s:g} s after {awaited}; {_SHOWN}"
                ) from None
            except ConnectionError:
                data = b""
            if not data:
                return None
            self._received += data
        line = bytes(self._received[:end])
        del self._received[: end + 1]
        return line

    def end(self) -> None:
        """`kill -9`."""
        self._received.clear()
        if self._connection is not None:
            self._connection.close()
            self._connection = None
        if self._program is not None:
            self._program.kill()
            self._program.wait()
            self._program = None

    def close(self) -> None:
        """End the program, and listen no longer."""
        self.end()
        self._server.close()

    @property
    def _name(self) -> str:
        return " ".join(self._command)

    def _fate(self) -> str:
        assert self._program is not None  # it was started
        status = self._program.poll()
        return "it still runs" if status is None else f"it ended with status {status}"


class LineController:
    """One connection of a program to the HLI.

    Args:
        robot: the robot that it drives.
        program: the program; it is started.
        note: gets all messages of the HLI.
        gone: called when the program has closed its end.
        say: sends to the HLI.

    Attributes:
        robot: the robot that it drives.
        token: of its lease; None without one.
        misbehaviour: of a fault; None while its increments are sent unchanged.
    """

    def __init__(
        self,
        robot: str,
        program: ControllerProcess,
        note: Callable[[Message], None],
        gone: Callable[[], None],
        say: Say,
    ) -> None:
        self.robot = robot
        self.token: str | None = None
        self.misbehaviour: Misbehaviour | None = None
        self._program, self._note, self._gone, self._say = program, note, gone, say
        self._name, self._asked = "", False
        program.start()

    def take(self, message: Message) -> None:
        """Take a message of the HLI; for a state, wait for the program's answer.

        Raises:
            ControllerProcessError: the program does not answer.
        """
        self._note(message)
        if isinstance(message, LeaseReply):
            self.token = message.lease if message.granted else self.token
            message = message.model_copy(update={"lease": None})
        if not isinstance(message, RobotState):
            self._program.say(to_line(message))
            return
        there = True
        while there and not self._asked:
            there = self._listen("it was started")  # it asks for its lease before anything moves
        self._program.say(to_line(message))
        if not (there and self._listen(f"the state of cycle {message.cycle}")):
            self._gone()

    def _listen(self, awaited: str) -> bool:
        """Let it say one line; whether it did."""
        line = self._program.hear(awaited)
        if line is None:
            return False
        try:
            self._pass_on(line_to_map(line))
        except InvalidMessageError as error:
            self._say(error)
        return True

    def _pass_on(self, data: dict[str, Any]) -> None:
        message_type = request_type(data)
        if message_type is Increment:
            dq, cycle = data.get("dq"), data.get("cycle")
            errs = self.misbehaviour is not None and isinstance(dq, list) and isinstance(cycle, int)
            for asked in (
                misbehaved(self.misbehaviour, cycle, dq) if errs and isinstance(cycle, int) else [dq]
            ):
                self._say(increment_of({**data, "dq": asked}, self.token))
            return
        request = from_map(message_type, data)
        if isinstance(request, LeaseRequest):
            self._asked = True
            request = request.model_copy(update={"lease": self.token, "client": self._name})
        self._name = data.get("client", self._name)
        self._say(request)
