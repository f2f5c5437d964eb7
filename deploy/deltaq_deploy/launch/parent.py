"""Helper processes that end with the program that started them, even if that is killed."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Coroutine
from typing import Any


async def while_parent_lives(work: Coroutine[Any, Any, None]) -> None:
    """Do this work, and cancel it at SIGTERM, or if the process that started this one ends.

    A process descriptor shows that it has ended: unlike the parent-death signal, this does not depend on
    the thread that started this process. The signal is the loop's to handle: a handler that raises would now and
    then do so inside a callback of asyncio's, and what waits for that callback would wait for ever.
    """
    parent = os.pidfd_open(os.getppid())
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(work)
    ended = False

    def end() -> None:
        nonlocal ended
        ended = True
        loop.remove_reader(parent)
        task.cancel()

    loop.add_reader(parent, end)
    loop.add_signal_handler(signal.SIGTERM, end)
    try:
        await task
    except asyncio.CancelledError:
        if not ended:
            raise
    finally:
        loop.remove_signal_handler(signal.SIGTERM)
        loop.remove_reader(parent)
        os.close(parent)
