"""A client of JSON lines, as a script would be."""

import asyncio
import json
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any


class JsonClient:
    """Sends lines, and waits for lines of a type."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader = reader
        self.writer = writer

    def send(self, **fields: Any) -> None:
        """Send one object."""
        self.send_bytes(json.dumps(fields).encode() + b"\n")

    def send_bytes(self, line: bytes) -> None:
        """Send what may be no object."""
        self.writer.write(line)

    async def receive(self, *types: str) -> dict[str, Any]:
        """The next object of one of these types; others are passed over."""
        async with asyncio.timeout(300):
            while True:
                line = await self.reader.readline()
                assert line, f"the connection ended while waiting for {types}"
                message: dict[str, Any] = json.loads(line)
                if message["type"] in types:
                    return message

    async def ask(self, *types: str, **fields: Any) -> dict[str, Any]:
        """Send one object and wait for the answer, or for an error."""
        self.send(**fields)
        return await self.receive(*types, "error")

    async def ended(self) -> None:
        """Wait until the server has ended the connection."""
        async with asyncio.timeout(300):
            try:
                while await self.reader.read(65536):
                    pass
            except ConnectionResetError:
                pass


@asynccontextmanager
async def json_client(
    port: int,
    name: str | None = "octave",
    host: str = "127.0.0.1",
    encryption: ssl.SSLContext | None = None,
    **hello: Any,
) -> AsyncIterator[JsonClient]:
    """A connected client; it has said hello unless `name` is None."""
    reader, writer = await asyncio.open_connection(host, port, limit=2**22, ssl=encryption)
    client = JsonClient(reader, writer)
    try:
        if name is not None:
            answer = await client.ask("welcome", type="hello", protocol=1, client=name, **hello)
            assert answer["type"] == "welcome", answer
        yield client
    finally:
        writer.close()
