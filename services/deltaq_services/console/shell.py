"""The console's process: one event loop with the web server, the HLI's link and the clients' connections."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from functools import partial
from typing import Any

import uvicorn
from fastapi import FastAPI, Response, WebSocket, WebSocketDisconnect
from pydantic import ValidationError
from starlette.middleware.trustedhost import TrustedHostMiddleware

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import messages as open_realm
from deltaq_protocol import topics
from deltaq_protocol.codec import InvalidMessageError, unpack
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_services.console.feed import RobotFeed
from deltaq_services.console.frame import NO_BODY, NearestBodies, pack_frame
from deltaq_services.console.hli_link import HliLink
from deltaq_services.console.messages import (
    COMMANDS,
    Ack,
    AckOutcome,
    Hello,
    LeaseView,
    Ping,
    Pong,
    RobotView,
    Status,
)
from deltaq_services.console.scene import MESHES, Scene, scene_of
from deltaq_services.console.settings import LOOPBACK_HOSTS, Settings

FRAME_S = 0.04
"""Time between two frames: 25 a second."""


class Console:
    """Walking skeleton."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.cell = CellModel.load(settings.cell)
        self.scene: Scene = scene_of(self.cell, settings.emulated)
        places = {name: place for place, name in enumerate(self.scene.bodies)}
        self.places = places
        description = self.cell.description
        self.feeds = {
            name: RobotFeed(robot, description.cycle_s, places) for name, robot in description.robots.items()
        }
        self.nearest = NearestBodies()
        self.status = Status(hli=False, text="not heard yet", robots={})
        self.sockets: set[WebSocket] = set()

    async def run(self, link: HliLink) -> None:
        """Tick for ever."""
        asyncio.get_running_loop().create_task(self.poll(link))
        while True:
            now = time.monotonic()
            for name, feed in self.feeds.items():
                heard = link.heard(name)
                if heard.states:
                    feed.arrived(heard.longest_gap_s, now)
                for payload in heard.states:
                    with contextlib.suppress(InvalidMessageError):
                        feed.take_state(unpack(open_realm.RobotState, payload), heard.state_s)
                for payload in heard.verdicts:
                    with contextlib.suppress(InvalidMessageError):
                        feed.take_verdict(unpack(open_realm.Verdict, payload), now)
            payload = link.proximity()
            if payload is not None:
                near = unpack(open_realm.Proximity, payload)
                if near.pairs:
                    pair = near.pairs[0]
                    self.nearest = NearestBodies(
                        self.places.get(pair.pair[0], NO_BODY),
                        self.places.get(pair.pair[1], NO_BODY),
                        pair.distance_m,
                        pair.points_m,
                    )
            frame = pack_frame(
                time.time(), None, self.nearest, [feed.frame(now) for feed in self.feeds.values()]
            )
            for socket_ in tuple(self.sockets):
                with contextlib.suppress(Exception):
                    await socket_.send_bytes(frame)
            await asyncio.sleep(FRAME_S)

    async def poll(self, link: HliLink) -> None:
        """Ask for the status."""
        while True:
            try:
                status = unpack(open_realm.Status, await link.ask(topics.STATUS))
                self.status = Status(
                    hli=True,
                    robots={
                        name: RobotView(
                            phase=robot.phase, reason=robot.reason, lease=LeaseView(holder=robot.lease.holder)
                        )
                        for name, robot in status.robots.items()
                    },
                )
            except DeltaqError as error:
                self.status = Status(hli=False, text=str(error), robots=self.status.robots)
            for socket_ in tuple(self.sockets):
                with contextlib.suppress(Exception):
                    await socket_.send_text(self.status.model_dump_json())
            await asyncio.sleep(0.5)

    async def live(self, websocket: WebSocket) -> None:
        """One browser."""
        await websocket.accept()
        await websocket.send_text(
            Hello(
                client="somebody",
                operator=self.settings.is_operator(websocket.query_params.get("token", "")),
                token_needed=self.settings.token_needed,
                server_ms=time.time() * 1000,
            ).model_dump_json()
        )
        self.sockets.add(websocket)
        try:
            while True:
                text = await websocket.receive_text()
                try:
                    command = COMMANDS.validate_json(text)
                except ValidationError as error:
                    await websocket.send_text(
                        Ack(id="", outcome=AckOutcome.REFUSED, text=str(error)).model_dump_json()
                    )
                    continue
                if isinstance(command, Ping):
                    await websocket.send_text(
                        Pong(
                            id=command.id, sent_ms=command.sent_ms, server_ms=time.time() * 1000
                        ).model_dump_json()
                    )
                else:
                    await websocket.send_text(
                        Ack(
                            id=command.id, outcome=AckOutcome.REFUSED, text="not served yet"
                        ).model_dump_json()
                    )
        except (WebSocketDisconnect, KeyError):
            pass
        finally:
            self.sockets.discard(websocket)


def serve(settings: Settings) -> None:
    """Serve until a signal ends the process.

    Raises:
        ServiceUnreachableError: the port is taken.
    """
    console = Console(settings)
    with socket.socket() as listening:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((settings.address, settings.port))
        except OSError as error:
            raise ServiceUnreachableError(
                f"the console cannot listen on {settings.address}:{settings.port}: {error.strerror}"
            ) from error
        asyncio.run(_serve(console, listening))


async def _serve(console: Console, listening: socket.socket) -> None:
    cell = console.cell.description
    async with HliLink(cell.hli, cell.cell, tuple(cell.robots)) as link:
        server = uvicorn.Server(
            uvicorn.Config(application(console), log_level="warning", access_log=False, lifespan="on")
        )
        ticking = asyncio.create_task(console.run(link))
        print(f"ready: console at http://{console.settings.address}:{console.settings.port}", flush=True)
        try:
            await server.serve(sockets=[listening])
        finally:
            ticking.cancel()


def application(console: Console) -> FastAPI:
    """The web application: the scene, its meshes, the live WebSocket, and the page."""
    app = FastAPI(openapi_url=None)
    if console.settings.is_loopback:
        app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOOPBACK_HOSTS))
    app.get("/scene.json")(partial(_scene, console))
    app.get(MESHES + "/{name}")(partial(_mesh, console))
    app.websocket("/live")(console.live)
    try:
        from deltaq_services.console import page  # type: ignore[attr-defined,unused-ignore]
    except ImportError:
        return app
    if hasattr(page, "build"):
        page.build(app, console.settings)
    return app


async def _scene(console: Console) -> dict[str, Any]:
    return console.scene.document


async def _mesh(console: Console, name: str) -> Response:
    text = console.scene.meshes.get(name)
    return Response(status_code=404) if text is None else Response(text, media_type="model/obj")
