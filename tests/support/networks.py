"""Networks of the tests' own, where they may make some."""

import functools
import shutil
import socket
import subprocess

from deltaq_protocol.errors import DeltaqError
from studies.two_sites.packets import PacketLink
from studies.two_sites.sites import sites


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


@functools.cache
def own_address() -> str | None:
    """This machine's address towards others, off the loopback; None if it has none. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return None
        return str(probe.getsockname()[0])


@functools.cache
def own_network() -> list[str] | None:
    """A command's beginning that gives it a network of its own, so that the pages' ports are free; None if refused."""
    up = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
    for unshare in (["unshare", "--net"], ["unshare", "--net", "--map-root-user"]):
        if (
            shutil.which("unshare")
            and not subprocess.run([*unshare, *up, "true"], capture_output=True, check=False).returncode
        ):
            return [*unshare, *up]
    return None
