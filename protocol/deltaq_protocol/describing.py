"""The first question of every client: which cell is served here, and in which version?"""

from __future__ import annotations

import asyncio
import contextlib

import msgpack

from deltaq_protocol import topics
from deltaq_protocol.codec import from_map
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import PROTOCOL_VERSION, DescribeRequest, Description
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.wire import LOOK_AGAIN_S, Wire

_CONNECT_DEADLINE_S = 3.0


async def described(wire: Wire, address: str) -> Description:
    """Ask for the description.

    Args:
        wire: a connection that has just been opened.
        address: of the server, for messages.

    Raises:
        ServiceUnreachableError: nobody there serves a cell.
        RefusedError: `protocol_version`, if the server speaks another version.
    """
    loop = asyncio.get_running_loop()
    give_up_s = loop.time() + _CONNECT_DEADLINE_S
    while (left_s := give_up_s - loop.time()) > 0.0:
        # it changes nothing, and so may be asked again: the link may not have told yet who is at its other end
        with contextlib.suppress(ServiceUnreachableError):
            return _of_our_version(
                await wire.ask(topics.DESCRIPTION, "*", DescribeRequest(), deadline_s=left_s)
            )
        await asyncio.sleep(LOOK_AGAIN_S)
    raise ServiceUnreachableError(
        f"{address} answers, but serves no cell; is it the address of an HLI (`hli` in the cell's YAML)?"
    )


def _of_our_version(payload: bytes) -> Description:
    # the version first: a description of another version may have other fields
    data = msgpack.unpackb(payload)
    theirs = data.get("protocol") if isinstance(data, dict) else None
    if theirs != PROTOCOL_VERSION:
        raise RefusedError(
            ReasonCode.PROTOCOL_VERSION,
            f"the server speaks protocol {theirs}, this client {PROTOCOL_VERSION}",
            "install the deltaq version that the server runs",
        )
    return from_map(Description, data)
