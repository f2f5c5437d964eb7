"""A controller as a program of its own, and the socket that it connects to."""

from __future__ import annotations

import socket
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from deltaq_protocol.codec import MAX_MESSAGE_BYTES
from deltaq_protocol.errors import DeltaqError

PATIENCE_S = 10.0
"""How long a program may take to connect, and to answer a state; virtual time stands still meanwhile."""
_SHOWN = (
    "a controller in virtual time answers every state with one line, an increment or the renewal of its lease"
)


class ControllerProcessError(DeltaqError):
    """The program under test cannot be started, or does not answer."""


class ControllerProcess:
    """Starts a program, and carries lines to it and from it.

    Args:
        command: the program and its arguments; `{port}` stands for the port to connect to.
        folder: that it is started in; None for the one that this program runs in.
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
        """Start the program anew and wait until it has connected.

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
        """Send a line; a program that has gone does not hear it."""
        if self._connection is not None:
            with suppress(OSError):
                self._connection.sendall(line)

    def hear(self, awaited: str) -> bytes | None:
        """The next line, waited for; None if the program has closed its end.

        Args:
            awaited: what it was asked for, for the error.

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
