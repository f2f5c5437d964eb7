"""The console's recordings over HTTP: the list, and one of them as a browser shows it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fastapi import FastAPI, HTTPException, Request, Response
from starlette.requests import HTTPConnection

from deltaq_services.console.door import Entrance
from deltaq_services.console.recordings import NoSuchRecordingError
from deltaq_services.console.replay_process import BusyError, UnreadableError
from deltaq_services.console.shell import Console

_NOT_PERMITTED, _NOT_FOUND, _UNREADABLE, _BUSY = 403, 404, 422, 503
_OF_THIS_PAGE = ("same-origin", "none")


def add_recordings(app: FastAPI, console: Console, enter: Callable[[HTTPConnection, str], Entrance]) -> None:
    """Serve `/recordings` and `/recordings/NAME` to operators: recordings have the audit log's entries too.

    Args:
        app: to add them to.
        console: the console whose recordings are served.
        enter: the role that a request's token gives.
    """

    def must_be_operators(request: Request) -> None:
        _must_be_own(request)
        kind, _, token = request.headers.get("authorization", "").partition(" ")
        if enter(request, token if kind.lower() == "bearer" else "") is not Entrance.OPERATOR:
            raise HTTPException(_NOT_PERMITTED, "recordings are for operators: the console's token makes one")

    @app.get("/recordings")
    async def recordings(request: Request) -> list[dict[str, Any]]:
        must_be_operators(request)
        return [] if console.folder is None else console.folder.listed()

    @app.get("/recordings/{name}")
    async def recording(name: str, request: Request) -> Response:
        must_be_operators(request)
        try:
            if console.folder is None:
                raise NoSuchRecordingError("the console was given no folder for recordings")
            document = await console.reader.read(console.folder.file(name))
        except NoSuchRecordingError as error:
            raise HTTPException(_NOT_FOUND, str(error)) from error
        except BusyError as error:
            raise HTTPException(_BUSY, str(error)) from error
        except UnreadableError as error:
            raise HTTPException(_UNREADABLE, str(error)) from error
        return Response(document, media_type="application/json")


def _must_be_own(request: Request) -> None:
    """Turn other web sites away: a browser says whose page asks; a program that is no browser does not."""
    if request.headers.get("sec-fetch-site", "same-origin") not in _OF_THIS_PAGE:
        raise HTTPException(_NOT_PERMITTED, "recordings are for this console's own page")
