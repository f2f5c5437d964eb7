"""One browser's WebSocket: what it sends is handed to the core, what it is sent never makes another wait.

Of frames only the newest waits to be sent. A browser that does not take its messages is disconnected.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import deque
from collections.abc import Callable

from fastapi import WebSocket, WebSocketDisconnect

_MOST_WAITING = 1000
_TOO_SLOW = 1013
_NOT_TEXT = 1007
"""Of WebSocket: a text that is not UTF-8, after which the server has ended the connection."""


class BrowserConnection:
    """One browser's connection, once it was let in.

    Args:
        websocket: accepted.
    """

    def __init__(self, websocket: WebSocket) -> None:
        self._websocket = websocket
        self._texts: deque[str] = deque()
        self._frame: bytes | None = None
        self._something = asyncio.Event()

    def put_text(self, text: str) -> None:
        """Send a message, after the messages that wait."""
        self._texts.append(text)
        self._something.set()

    def put_frame(self, frame: bytes) -> None:
        """Send a frame, and drop a frame that still waits."""
        self._frame = frame
        self._something.set()

    async def serve(self, take: Callable[[str | bytes], None]) -> None:
        """Pass on the browser's messages, until it disconnects or stops taking messages."""
        receiving = asyncio.ensure_future(self._receive(take))
        sending = asyncio.ensure_future(self._send())
        try:
            await asyncio.wait((receiving, sending), return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (receiving, sending):
                task.cancel()
            await asyncio.gather(receiving, sending, return_exceptions=True)
            with contextlib.suppress(RuntimeError, WebSocketDisconnect):  # it has gone already
                await self._websocket.close(_TOO_SLOW if len(self._texts) > _MOST_WAITING else 1000)

    async def _receive(self, take: Callable[[str | bytes], None]) -> None:
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                if message.get("code") == _NOT_TEXT:
                    take(b"")  # counted as every malformed message is
                return
            text = message.get("text")
            take(text if text is not None else message.get("bytes") or b"")

    async def _send(self) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while len(self._texts) <= _MOST_WAITING:
                await self._something.wait()
                self._something.clear()
                while self._texts:
                    await self._websocket.send_text(self._texts.popleft())
                if self._frame is not None:
                    frame, self._frame = self._frame, None
                    await self._websocket.send_bytes(frame)
