"""What the clients in other languages say and read are fields of the exported schema."""

import json
import re
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from languages import LANGUAGES, Language
from ran import ran
from served import Server

from deltaq_protocol.proof import line_proof

READ = re.compile(
    r"""\b(?:state|verdict|reason|answer|lease|welcome|message|error|refusal|newest\(\)|description)
        (?:\.(?P<dot>[a-z_]+)\b(?!\()|\["(?P<index>[a-z_]+)"\])""",
    re.VERBOSE,
)
"""A field of a message, as MATLAB and JavaScript or as C++ name it."""
TAKEN_APART = re.compile(r"\{ ([a-z_, ]+) \} (?:=|of) ")
"""Fields of a message, as JavaScript takes it apart."""


@cache
def schema() -> dict[str, list[dict[str, Any]]]:
    """Schemas by the `type` of the message, as `deltaq schema` prints them; of a lease, request and reply."""
    told = ran([sys.executable, "-c", "from deltaq_deploy.command import main; main()", "schema"])
    found: dict[str, list[dict[str, Any]]] = {}
    document = json.loads(told.stdout)
    messages = list(document.pop("json-lines")["only over TCP"])
    for row in document.values():
        messages += [row["message"], row["reply"]]
    for message in messages:
        kind = ((message or {}).get("properties", {}).get("type") or {}).get("const")
        if kind and message not in found.setdefault(kind, []):
            found[kind].append(message)
    return found


def fields(kind: str) -> set[str]:
    return {name for message in schema()[kind] for name in message["properties"]}


class Listener(threading.Thread):
    """Stands between a client and the server, and keeps what the client says."""

    def __init__(self, server_port: int) -> None:
        super().__init__(daemon=True)
        self._door = socket.create_server(("127.0.0.1", 0))
        self._server_port = server_port
        self.port: int = self._door.getsockname()[1]
        self.said = b""

    def run(self) -> None:
        client, _ = self._door.accept()
        self._door.close()
        with client, socket.create_connection(("127.0.0.1", self._server_port)) as server:
            back = threading.Thread(target=lambda: list(_pumped(server, client)), daemon=True)
            back.start()
            for some in _pumped(client, server):
                self.said += some
            back.join()


def _pumped(source: socket.socket, sink: socket.socket) -> Iterator[bytes]:
    with suppress(OSError):  # who closes before it has read all ends its connection with a reset
        while some := source.recv(65536):
            yield some
            sink.sendall(some)
    with suppress(OSError):
        sink.shutdown(socket.SHUT_WR)


@pytest.mark.service
@pytest.mark.parametrize("language", LANGUAGES, ids=lambda language: language.name)
def test_every_sent_line_is_valid_by_the_exported_schema(language: Language) -> None:
    if why_not := language.why_not():
        pytest.skip(why_not)
    with Server() as server:
        listener = Listener(server.description.tcp_port)
        listener.start()
        done = ran(
            language.turn_a1(listener.port),
            env=language.environment(DELTAQ_CLIENT_TOKEN='with "quotes"'),
            check=False,
        )
        listener.join()
    assert done.returncode == 0, done.stderr
    said = [json.loads(line) for line in listener.said.splitlines()]
    assert {message["type"] for message in said} == {"challenge", "hello", "lease", "increment"}
    assert [message.get("action") for message in said if message["type"] == "lease"][-1] == "release"
    assert not any("token" in message for message in said), "who listens at the port learns it otherwise"
    hello = said[1]
    assert hello["proof"] == line_proof('with "quotes"', hello["challenge"])
    for message in said:
        jsonschema.validate(message, schema()[message["type"]][0])


@pytest.mark.long
@pytest.mark.parametrize("language", LANGUAGES, ids=lambda language: language.name)
def test_every_read_field_is_in_the_exported_schema(language: Language) -> None:
    kinds = ("welcome", "challenge", "state", "verdict", "lease", "error", "description")
    known = set().union(*(fields(kind) for kind in kinds)) | {"code", "what", "value", "bound"}
    text = "\n".join(map(_without_comments, language.sources))
    read = {match["dot"] or match["index"] for match in READ.finditer(text)}
    read |= {name for match in TAKEN_APART.finditer(text) for name in match[1].split(", ")}
    of_the_language = (
        {"list", "text", "is_null", "number", "fields", "type"} if language.name == "c++" else {"type"}
    )
    assert {"cycle", "robot", "holder", "q_ahead"} <= read
    assert read - of_the_language <= known


def _without_comments(source: Path) -> str:
    return "\n".join(re.sub(r"(//|%).*", "", line) for line in source.read_text().splitlines())
