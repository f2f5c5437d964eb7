"""A relay in a separate process, controlled over a pipe."""

import asyncio
import multiprocessing
import signal
from multiprocessing.connection import Connection
from typing import Self

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_testing.impairment.relay import TrafficUnit, relay
from deltaq_testing.impairment.tcp import StreamFaults

_ANSWER_S = 20.0


class RelayProcess:
    """A relay that nothing else slows down; a context manager.

    Args:
        listen, to, unit, seed: as `relay` takes them.

    Raises:
        DeltaqError: on entering, as `relay` does.
    """

    def __init__(self, listen: Endpoint, to: Endpoint, unit: TrafficUnit, seed: int = 0) -> None:
        # spawned: a fork of a process with zenoh's threads could hang for ever
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, listen, to, unit, seed), name=f"relay to {to}", daemon=True
        )
        self._theirs = theirs

    def __enter__(self) -> Self:
        self._process.start()
        self._theirs.close()
        try:
            self._await_answer()
        except DeltaqError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._pipe.close()  # ends it
        self._process.join(_ANSWER_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def impair(self, faults: StreamFaults | LinkFaults) -> None:
        """Set the link's faults; they apply when this returns."""
        self._pipe.send(faults)
        self._await_answer()

    def _await_answer(self) -> None:
        try:
            answer = self._pipe.recv() if self._pipe.poll(_ANSWER_S) else "no answer"
        except EOFError:
            answer = "it has ended"
        if answer is not None:
            raise ServiceUnreachableError(f"{self._process.name}: {answer}")


def _serve(pipe: Connection, listen: Endpoint, to: Endpoint, unit: TrafficUnit, seed: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # its parent ends it
    try:
        asyncio.run(_relay(pipe, listen, to, unit, seed))
    except DeltaqError as error:
        pipe.send(str(error))


async def _relay(pipe: Connection, listen: Endpoint, to: Endpoint, unit: TrafficUnit, seed: int) -> None:
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    async with relay(listen, to, unit, seed) as running:

        def obey() -> None:
            try:
                faults = pipe.recv()
            except EOFError:
                loop.remove_reader(pipe.fileno())
                ended.set()
                return
            running.impair(faults)
            pipe.send(None)

        pipe.send(None)
        loop.add_reader(pipe.fileno(), obey)
        await ended.wait()
