"""Helper processes that end with the program that started them, even if that is killed."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Coroutine
from typing import Any


async def while_parent_lives(work: Coroutine[Any, Any, None]) -> None:
    """Do this work, and cancel it if the process that started this one ends.

    A process descriptor shows that it has ended: unlike the parent-death signal, this does not depend on
    the thread that started this process.
    """
    parent = os.pidfd_open(os.getppid())
    loop, task = asyncio.get_running_loop(), asyncio.ensure_future(work)
    abandoned = False

    def end() -> None:
        nonlocal abandoned
        abandoned = True
        loop.remove_reader(parent)
        task.cancel()

    loop.add_reader(parent, end)
    try:
        await task
    except asyncio.CancelledError:
        if not abandoned:
            raise
    finally:
        loop.remove_reader(parent)
        os.close(parent)
