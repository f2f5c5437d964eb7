"""An HLI in a thread of its own, for tests that are written as a plain script is."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from typing import Any

from guarded_peer import GuardedPeer, guarded_peer
from small_cell import small_cell, told, tool_pose

from deltaq_protocol.guarded import Command
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.line_encryption import line_encryption
from deltaq_services.hli.shell import Hli


class Server:
    """An HLI and its peer, which turns in the cell's cycle, for the length of a block.

    Args:
        operator_token: as `ClientRoles` takes it.
        controller_token: the same.
        encrypted: the environment of `line_encryption`, if lines are to be encrypted.
        changes: to the description of the small cell.

    Attributes:
        description: of the cell.
        peer: plays the guarded realm.
        hli: the server itself.
        errors: what went wrong in the loop without anybody to be told.
    """

    def __init__(
        self,
        operator_token: str | None = None,
        controller_token: str | None = None,
        encrypted: Mapping[str, str] | None = None,
        **changes: Any,
    ) -> None:
        self.description = small_cell(**changes)
        self._roles = ClientRoles(operator_token, controller_token)
        self._encryption = line_encryption(self.description, encrypted or {})
        self.errors: list[dict[str, Any]] = []
        self.peer: GuardedPeer
        self.hli: Hli
        self._loop: asyncio.AbstractEventLoop
        self._done: asyncio.Event
        self._ready = threading.Event()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._failure = error
            self._ready.set()

    async def _serve(self) -> None:
        self._loop, self._done = asyncio.get_running_loop(), asyncio.Event()
        self._loop.set_exception_handler(lambda _, context: self.errors.append(context))
        description = self.description
        async with (
            guarded_peer(description) as self.peer,
            Hli(description, told(description), tool_pose, self._roles, self._encryption) as self.hli,
        ):
            await self.peer.turn()
            cycles = asyncio.create_task(self.peer.run())
            self._ready.set()
            await self._done.wait()
            cycles.cancel()

    def __enter__(self) -> Server:
        self._thread.start()
        assert self._ready.wait(300)
        if self._failure is not None:
            raise self._failure
        return self

    def __exit__(self, *_: object) -> None:
        if self._failure is None:
            self._loop.call_soon_threadsafe(self._done.set)
        self._thread.join()
        if self._failure is not None:
            raise self._failure

    def command(self) -> Command:
        """The next that its peer got from the HLI; waits for it."""
        return asyncio.run_coroutine_threadsafe(self.peer.commands.get(), self._loop).result(300)
