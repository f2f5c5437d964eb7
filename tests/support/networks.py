"""Whether tests may make networks of their own here."""

from __future__ import annotations

import functools

from deltaq_protocol.errors import DeltaqError
from deltaq_verification.impairment.packets import PacketLink
from deltaq_verification.two_sites import sites


@functools.cache
def why_none() -> str:
    """Why there can be no networks of their own; empty if there can."""
    import asyncio

    async def link() -> None:
        with sites() as made:
            async with PacketLink(made.controller, made.office):
                made.connect_wide_area()

    try:
        asyncio.run(link())
    except DeltaqError as error:
        return str(error)
    return ""
