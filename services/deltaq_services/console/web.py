"""The console's web server: the page, the scene and its meshes, recordings, the live WebSocket, and live pictures.

Protected content goes only to the console's own pages (a browser names the asking page), and only under the
console's own host names, so no other web site can pose as it. The `Door` decides on access.
"""

import asyncio
import contextlib
import logging
import signal
import socket
import time
from collections.abc import Generator, Sequence
from pathlib import Path
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import HTTPConnection, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketClose, WebSocketDisconnect

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_services.console.recordings import BusyError, NoSuchRecordingError, UnreadableError
from deltaq_services.console.scene import MESHES
from deltaq_services.console.settings import LOOPBACK_HOSTS, Door, Entrance, Settings
from deltaq_services.console.shell import BrowserConnection, Console
from deltaq_services.video_stream import ASK, LENGTH, MOST_BYTES, on_clock

_log = logging.getLogger(__name__)

_PAGE = Path(__file__).parent / "page"
_PAGE_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; font-src 'self'; "
    "img-src 'self' data: blob:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-cache",  # a page of another version is never mixed with this one
    "Referrer-Policy": "no-referrer",  # its address may have the token
    "X-Content-Type-Options": "nosniff",
}

_LONGEST_BYTES = 64 * 1024
"""Longest message that is read; commands are shorter, and a longer message gets an error."""
_NOT_PERMITTED, _TRY_AGAIN = 1008, 1013
_LONGEST_NAME, _LONGEST_SESSION = 32, 64


def serve(settings: Settings) -> None:
    """Serve until a signal ends the process.

    Raises:
        ServiceUnreachableError: the port is taken.
    """
    with listening_socket(settings) as listening:
        console = Console(CellModel.load(settings.cell), settings)
        asyncio.run(_serve(console, settings, listening))


async def _serve(console: Console, settings: Settings, listening: socket.socket) -> None:
    server = server_of(application(console, settings))
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

    @contextlib.contextmanager
    def capture_signals(self) -> Generator[None, None, None]:
        yield


def _is_told(record: logging.LogRecord) -> bool:
    """Whether a line of uvicorn's log is shown: not its traceback of bytes that are no text, which are counted."""
    return not (record.exc_info and isinstance(record.exc_info[1], UnicodeError))


def server_of(app: Starlette) -> uvicorn.Server:
    """The server of an application; it reads no more of a message than is needed to refuse it."""
    logging.getLogger("uvicorn.error").addFilter(_is_told)
    return _Server(
        uvicorn.Config(
            app,
            log_config=None,  # this process logs all that it says in one way
            log_level="warning",
            access_log=False,
            http="h11",  # the parser of uvicorn, which is tested; another one may be installed
            ws_max_size=_LONGEST_BYTES,
            ws_per_message_deflate=False,  # messages are small, and soon old
            ws_ping_interval=2.0,
            ws_ping_timeout=5.0,
            timeout_graceful_shutdown=1,
        )
    )


def application(console: Console, settings: Settings) -> Starlette:
    """The web application."""
    served = _Served(console, Door(settings, console.core.counters))
    return Starlette(
        routes=[
            Route("/scene.json", served.scene),
            Route("/health", served.health),
            Route(MESHES + "/{name}", served.mesh),
            Route("/recordings", served.recordings),
            Route("/recordings/{name}", served.recording),
            Route("/recordings/{name}/{picture}", served.picture),
            WebSocketRoute("/live", served.live),
            WebSocketRoute("/video/{name}", served.video),
            Mount("/", _Page(directory=_PAGE, html=True)),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=list(LOOPBACK_HOSTS))]
        if settings.is_loopback
        else [],
    )


class _Page(StaticFiles):
    """The page's files; it runs no script and loads nothing but what this console serves."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":  # the console has no other than these
            await WebSocketClose(_NOT_PERMITTED)(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)

    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers.update(_PAGE_HEADERS)
        return response


class _Served:
    """Answers browsers.

    Args:
        console: that is served.
        door: looks at tokens.
    """

    def __init__(self, console: Console, door: Door) -> None:
        self._console, self._door = console, door

    async def scene(self, _: Request) -> Response:
        return JSONResponse(self._console.scene.document)

    async def health(self, _: Request) -> Response:
        return JSONResponse(self._console.core.health())

    async def mesh(self, request: Request) -> Response:
        text = self._console.scene.meshes.get(request.path_params["name"])
        return Response(status_code=404) if text is None else Response(text, media_type="model/obj")

    async def recordings(self, request: Request) -> Response:
        folder = self._console.folder
        return self._refused(request) or JSONResponse([] if folder is None else folder.listed())

    async def recording(self, request: Request) -> Response:
        """A recording as a browser shows it."""
        refused = self._refused(request)
        if refused is not None:
            return refused
        try:
            if self._console.folder is None:
                raise NoSuchRecordingError("the console was given no folder for recordings")
            file = self._console.folder.file(request.path_params["name"])
            document = await self._console.reader.read(file)
        except NoSuchRecordingError as error:
            return _told(404, str(error))
        except UnreadableError as error:
            return _told(422, str(error))
        except BusyError as error:
            return _told(503, str(error))
        return Response(document, media_type="application/json")

    async def picture(self, request: Request) -> Response:
        """A live picture as a recording has it."""
        refused = self._refused(request)
        if refused is not None or self._console.folder is None:
            return refused or Response(status_code=404)
        try:
            file = self._console.folder.picture(**request.path_params)
        except NoSuchRecordingError as error:
            return _told(404, str(error))
        return Response(file.read_bytes(), media_type="image/jpeg")

    def _refused(self, request: Request) -> Response | None:
        """Why a request gets no recording: those have the audit log's entries too, and are for operators."""
        # a browser says whose page asks; a program that is no browser does not
        if request.headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return _told(403, "only this console's own page gets recordings")
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        if self._enter(request, token if kind.lower() == "bearer" else "") is not Entrance.OPERATOR:
            return _told(403, "only operators get recordings: show the console's token")
        return None

    async def live(self, websocket: WebSocket) -> None:
        """Serve the WebSocket of one browser until it disconnects."""
        entrance = await self._accepted(websocket, (Entrance.OPERATOR, Entrance.OBSERVER))
        if entrance is None:
            return
        asked = websocket.query_params
        name = asked.get("name", "").strip()[:_LONGEST_NAME]
        session, page = (asked.get(key, "")[:_LONGEST_SESSION] for key in ("session", "page"))
        await self._console.serve(
            BrowserConnection(websocket),
            name if name.isprintable() else "",
            entrance is Entrance.OPERATOR,
            _address(websocket),
            session,
            page,
        )

    async def video(self, websocket: WebSocket) -> None:
        """Serve one browser the live picture of a camera, which may show people: it is for operators."""
        path = self._console.pictures.get(websocket.path_params["name"])
        if path is None:
            await websocket.close(_NOT_PERMITTED)
        elif await self._accepted(websocket, (Entrance.OPERATOR,)) is not None:
            await _relay(websocket, path, self._console.epoch_s)

    async def _accepted(self, websocket: WebSocket, roles: Sequence[Entrance]) -> Entrance | None:
        """Accept a WebSocket of the console's own page with one of these roles; None if it was turned away."""
        entrance = self._enter(websocket, websocket.query_params.get("token", ""))
        origin = websocket.headers.get("origin")  # a program that is no browser does not say
        is_own = origin is None or urlsplit(origin).netloc == websocket.headers.get("host")
        if not is_own or entrance not in roles:
            self._console.core.counters["turned_away"] += 1
            await websocket.close(_NOT_PERMITTED)
            return None
        await websocket.accept()
        return entrance

    def _enter(self, request: HTTPConnection, token: str) -> Entrance:
        entrance = self._door.look(token, _address(request), time.monotonic())
        if entrance is Entrance.WRONG:
            _log.warning("a wrong token from %s at the console", _address(request))
        return entrance


async def _relay(websocket: WebSocket, path: Path, epoch_s: float) -> None:
    """Serve one browser until it or the service leaves; the page connects again.

    Args:
        websocket: accepted; each message of it asks for a picture.
        path: of the socket of the picture's service.
        epoch_s: how far the console's clock is ahead of the monotonic one [s].
    """
    with contextlib.suppress(OSError):
        reader, writer = await asyncio.open_unix_connection(path)
        tasks = [
            asyncio.ensure_future(_ask(websocket, writer)),
            asyncio.ensure_future(_answer(websocket, reader, epoch_s)),
        ]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        writer.close()
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it has gone already
        await websocket.close(_TRY_AGAIN, "the service of its picture does not run")


async def _ask(websocket: WebSocket, writer: asyncio.StreamWriter) -> None:
    while (await websocket.receive())["type"] != "websocket.disconnect":
        writer.write(ASK)
        await writer.drain()


async def _answer(websocket: WebSocket, reader: asyncio.StreamReader, epoch_s: float) -> None:
    while True:
        (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
        if length > MOST_BYTES:
            return
        await websocket.send_bytes(on_clock(await reader.readexactly(length), epoch_s))


def _address(request: HTTPConnection) -> str:
    return request.client.host if request.client else ""


def _told(status: int, text: str) -> Response:
    return JSONResponse({"detail": text}, status)


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
