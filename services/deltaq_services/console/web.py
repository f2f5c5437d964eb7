"""The console's web server: the page, the scene and its meshes, and the live WebSocket with its door.

The door: only this machine, or a token; only pages of this console's own (a browser says which page opens a WebSocket);
only names by which it is called, so that no web site can pretend to be it.
"""

from __future__ import annotations

import asyncio
import logging
import signal
import socket
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any
from urllib.parse import urlsplit

import uvicorn
from fastapi import FastAPI, Response, WebSocket
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_services.console import page
from deltaq_services.console.connection import BrowserConnection
from deltaq_services.console.door import Door, Entrance
from deltaq_services.console.recordings_web import add_recordings
from deltaq_services.console.scene import MESHES
from deltaq_services.console.settings import LOOPBACK_HOSTS, Settings
from deltaq_services.console.shell import Console

_log = logging.getLogger(__name__)

_LONGEST_BYTES = 64 * 1024
"""Longest message that is read at all; commands are shorter, and this much is told so."""
_NOT_PERMITTED = 1008
_LONGEST_NAME, _LONGEST_SESSION = 32, 64


def serve(settings: Settings) -> None:
    """Serve until a signal ends the process.

    Raises:
        ServiceUnreachableError: the port is taken.
    """
    with listening_socket(settings) as listening:
        console = Console(
            CellModel.load(settings.cell),
            settings.emulated,
            settings.token_needed,
            settings.operator_token,
            settings.cell,
            settings.recordings,
        )
        asyncio.run(_serve(console, settings, listening))


async def _serve(console: Console, settings: Settings, listening: socket.socket) -> None:
    app = application(console, settings)
    page.build(app, settings)
    server = server_of(app)
    running = asyncio.ensure_future(console.run())
    serving = asyncio.ensure_future(server.serve(sockets=[listening]))
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    _log.info("ready: console at %s", settings.url)
    await asyncio.wait((running, serving), return_when=asyncio.FIRST_COMPLETED)
    running.cancel()
    server.should_exit = True
    ended = await asyncio.gather(running, serving, return_exceptions=True)
    for error in ended:
        if isinstance(error, Exception):  # neither cancelled nor done
            raise error


class _Server(uvicorn.Server):
    """uvicorn's server without its handlers of signals, which are the console's: robots come to rest first."""

    @contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


def _is_told(record: logging.LogRecord) -> bool:
    """Whether a line of uvicorn's log is shown: not its traceback of bytes that are no text, which are counted."""
    return not (record.exc_info and isinstance(record.exc_info[1], UnicodeError))


def server_of(app: FastAPI) -> uvicorn.Server:
    """The server of an application; it reads no more of a message than is needed to refuse it."""
    logging.getLogger("uvicorn.error").addFilter(_is_told)
    return _Server(
        uvicorn.Config(
            app,
            log_config=None,  # this process logs all that it says in one way
            log_level="warning",
            access_log=False,
            ws_max_size=_LONGEST_BYTES,
            ws_per_message_deflate=False,  # messages are small, and soon old
            ws_ping_interval=2.0,
            ws_ping_timeout=5.0,
            timeout_graceful_shutdown=1,
        )
    )


def application(console: Console, settings: Settings) -> FastAPI:
    """The web application, without its page."""
    app = FastAPI(openapi_url=None)
    if settings.is_loopback:
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOOPBACK_HOSTS))

    @app.get("/scene.json")
    async def scene() -> dict[str, Any]:
        return console.scene.document

    @app.get("/health")
    async def health() -> dict[str, Any]:
        return console.core.health()

    @app.get(MESHES + "/{name}")
    async def mesh(name: str) -> Response:
        text = console.scene.meshes.get(name)
        return Response(status_code=404) if text is None else Response(text, media_type="model/obj")

    door = Door(settings, console.core.counters)

    def enter(request: HTTPConnection, token: str) -> Entrance:
        address = request.client.host if request.client else ""
        entrance = door.look(token, address, time.monotonic())
        if entrance is Entrance.WRONG:
            _log.warning("a wrong token from %s at the console", address)
        return entrance

    add_recordings(app, console, enter)

    @app.websocket("/live")
    async def live(websocket: WebSocket) -> None:
        entrance = enter(websocket, websocket.query_params.get("token", ""))
        if not _is_own(websocket) or entrance not in (Entrance.OPERATOR, Entrance.OBSERVER):
            console.core.counters["turned_away"] += 1
            await websocket.close(_NOT_PERMITTED)
            return
        await websocket.accept()
        name = websocket.query_params.get("name", "").strip()[:_LONGEST_NAME]
        session, page = (
            websocket.query_params.get(key, "")[:_LONGEST_SESSION] for key in ("session", "page")
        )
        address = websocket.client.host if websocket.client else ""
        is_operator = entrance is Entrance.OPERATOR
        shown = name if name.isprintable() else ""
        await console.serve(BrowserConnection(websocket), shown, is_operator, address, session, page)

    return app


def _is_own(websocket: WebSocket) -> bool:
    """Whether the WebSocket is opened by a page of this console; a program that is no browser does not say."""
    origin = websocket.headers.get("origin")
    return origin is None or urlsplit(origin).netloc == websocket.headers.get("host")


def listening_socket(settings: Settings) -> socket.socket:
    """The socket that browsers connect to.

    Raises:
        ServiceUnreachableError: the port is taken.
    """
    listening = socket.socket(socket.AF_INET6 if ":" in settings.address else socket.AF_INET)
    # a port that was just given up can be taken again at once; one that is in use cannot
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((settings.address, settings.port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise ServiceUnreachableError(
            f"the console cannot listen on {settings.address}:{settings.port}: {error.strerror}; "
            "choose another port with console_port in the cell's file"
        ) from error
    return listening
