"""The conversation in the how-to on sockets is held as it is printed, with a running HLI."""

import json
import re
import socket
from pathlib import Path
from typing import Any

import pytest
from served import Server

HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "talk-over-a-socket.md"
LEFT_OUT = "..."


def printed() -> list[tuple[float, str, dict[str, Any]]]:
    """Time [s], direction and message of each line."""
    block = re.search(
        r"<!-- not run: tests/services/test_printed_conversation.py holds it with a running HLI -->\n```\n(.*?)^```",
        HOW_TO.read_text(),
        re.MULTILINE | re.DOTALL,
    )
    assert block
    lines = [line.split(" ", 2) for line in block[1].splitlines()]
    return [(float(time), direction, json.loads(text)) for time, direction, text in lines]


def is_as_printed(got: Any, wanted: Any) -> bool:
    """Whether a value is the printed one; what is left out may be anything."""
    if isinstance(wanted, str) and LEFT_OUT in wanted:
        before, _, after = wanted.partition(LEFT_OUT)
        return wanted == LEFT_OUT or (got.startswith(before) and got.endswith(after))
    if isinstance(wanted, dict):
        return got.keys() == wanted.keys() and all(is_as_printed(got[key], wanted[key]) for key in wanted)
    if isinstance(wanted, list):
        return len(got) == len(wanted) and all(map(is_as_printed, got, wanted))
    return bool(got == pytest.approx(wanted, abs=0.05) if isinstance(wanted, float) else got == wanted)


class Conversation:
    """Says what is printed, with the cycles of the running robot in place of the printed ones."""

    def __init__(self, server: Server, sock: socket.socket) -> None:
        self._server = server
        self._sock = sock
        self._lines = sock.makefile("rb")
        self._printed_cycle = self._cycle = 0

    def say(self, message: dict[str, Any]) -> None:
        self._sock.sendall(json.dumps(self._in_our_cycles(message)).encode() + b"\n")

    def hear(self, wanted: dict[str, Any]) -> None:
        got = self._next(wanted)
        if wanted["type"] == "state":
            self._printed_cycle, self._cycle = wanted["cycle"], got["cycle"]
        assert is_as_printed(got, self._in_our_cycles(wanted)), (got, wanted)

    def _next(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """The next message that is no state, or where a state is wanted, the one of this very moment."""
        now = self._server.peer.cycle
        while line := self._lines.readline():
            message: dict[str, Any] = json.loads(line)
            if message["type"] == wanted["type"] and (wanted["type"] != "state" or message["cycle"] >= now):
                return message
            assert message["type"] == "state", (message, wanted)
        pytest.fail(f"the connection ended before {wanted}")

    def _in_our_cycles(self, message: dict[str, Any]) -> dict[str, Any]:
        shift = self._cycle - self._printed_cycle
        numbered = [name for name in ("cycle", "setpoint_cycle") if message.get(name) is not None]
        ours = {name: message[name] + shift for name in numbered}
        if message.get("outcome") == "refused":
            (reason,) = message["reasons"]
            ours["reasons"] = [reason | {"value": reason["value"] + shift}]
        return message | ours


@pytest.mark.service
def test_the_printed_conversation_agrees_with_a_running_hli() -> None:
    with Server() as server, socket.create_connection(("127.0.0.1", server.description.tcp_port), 20) as sock:
        conversation = Conversation(server, sock)
        for _, direction, message in printed():
            (conversation.say if direction == ">" else conversation.hear)(message)
        assert server.hli.status().robots["fr"].lease.holder is None
        assert server.errors == []


def test_the_printed_times_show_the_permitted_silence_of_a_holder() -> None:
    lines = printed()
    ((lapsed, sent),) = [
        (time, max(said for said, direction, _ in lines if direction == ">" and said < time))
        for time, _, message in lines
        if message["type"] == "error" and message["request"] is None
    ]
    assert lapsed - sent == pytest.approx(Server().description.lease_s)
    assert [time for time, _, _ in lines] == sorted(time for time, _, _ in lines)
