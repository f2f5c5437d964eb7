"""A console for the length of a block, and what a browser says to it and hears, without its page."""

import asyncio
import itertools
import json
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import websockets

from deltaq_cell.cell_model import CellModel
from deltaq_services.console.settings import Settings
from deltaq_services.console.shell import Console
from deltaq_services.console.web import application, listening_socket, server_of
from deltaq_testing.private_cell import write_private_cell


@asynccontextmanager
async def served(
    folder: Path,
    token: str = "",
    cell: CellModel | None = None,
    operator_token: str | None = None,
    recordings: Path | None = None,
) -> AsyncIterator[tuple[Console, str]]:
    """A console and where it is reached; without a cell, one whose HLI is not there."""
    cell = cell or CellModel.load(write_private_cell(folder))
    port = cell.description.console_port
    settings = Settings("lab", True, "127.0.0.1", port, token, operator_token, recordings=recordings)
    console = Console(cell, settings)
    server = server_of(application(console, settings))
    with listening_socket(settings) as listening:
        running = asyncio.ensure_future(console.run())
        serving = asyncio.ensure_future(server.serve(sockets=[listening]))
        try:
            yield console, f"127.0.0.1:{settings.port}"
        finally:
            server.should_exit = True
            running.cancel()
            await asyncio.gather(running, serving, return_exceptions=True)


def live(host: str, **query: str) -> str:
    """Where a browser opens its WebSocket."""
    return f"ws://{host}/live?" + "&".join(f"{name}={value}" for name, value in query.items())


async def told(websocket: Any, kind: str) -> dict[str, Any]:
    """The next text message of that type."""
    while True:
        message = await websocket.recv()
        if isinstance(message, str) and (said := json.loads(message))["type"] == kind:
            return dict(said)


class Browser:
    """Asks for what buttons of the page ask for.

    Args:
        websocket: to the console.
    """

    def __init__(self, websocket: websockets.ClientConnection) -> None:
        self._websocket = websocket
        self._numbers = itertools.count(1)

    async def ask(self, kind: str, **fields: Any) -> dict[str, Any]:
        """The last answer to a command: what has become of it, not that it was passed on."""
        number = str(next(self._numbers))
        command = {"type": kind, "id": number, "sent_ms": 1000 * time.time(), **fields}
        await self._websocket.send(json.dumps(command))
        while True:
            answer = await told(self._websocket, "ack")
            if answer["id"] == number and answer["outcome"] != "asked":
                return answer

    async def status(self) -> dict[str, Any]:
        """The next status."""
        return await told(self._websocket, "status")
