"""The lab cell on ports of its own, so that a test disturbs nobody."""

from __future__ import annotations

import fcntl
import functools
import itertools
import os
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

FIRST_PORT = 15_000
"""Ports from here on are drawn from, to below those that the system gives to sockets that ask for none."""
PORTS_A_BLOCK = 200


def free_ports(count: int) -> list[int]:
    """Ports of the loopback that nobody listens on, neither over TCP nor over UDP.

    They are never among those that the system gives to a socket that asks for none, since a service which
    connects while the cell starts would be given one of them now and then. Each process draws from a block of its own.
    """
    return list(itertools.islice((port for port in _ports() if _is_free(port)), count))


@functools.cache
def _ports() -> Iterator[int]:
    """The ports of this process's block, round and round."""
    ephemeral = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    # a system that gives all its ports to whoever asks leaves none that are safe
    end = max(ephemeral, 2 * FIRST_PORT) - PORTS_A_BLOCK
    for first in range(FIRST_PORT, end, PORTS_A_BLOCK):
        if _claims(first) is not None:
            return itertools.cycle(range(first, first + PORTS_A_BLOCK))
    raise RuntimeError(f"every block of ports from {FIRST_PORT} to {end} is claimed")


@functools.cache
def _claims(first: int) -> IO[str] | None:
    """A lock on a block of ports, kept open until this process ends; None if another process has it."""
    folder = Path(tempfile.gettempdir()) / f"deltaq-test-ports-{os.getuid()}"
    folder.mkdir(exist_ok=True)
    file = (folder / str(first)).open("a")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        return None
    return file


def _is_free(port: int) -> bool:
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        # a connection that has ended lately is nobody who listens
        tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tcp.bind(("127.0.0.1", port))
            udp.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def write_private_cell(
    folder: Path, base: str = "lab", guarded: str = "127.0.0.1", transport: str = "tcp"
) -> Path:
    """Write a cell file that differs from a shipped cell by its ports, and by where the guarded realm listens."""
    hli, sim, tcp, console, *robots = free_ports(10)
    drivers = {
        name: f"""
  {name}:
    server: {transport}/{guarded}:{server}
    driver: {{port: {port}, control_port: {panel}}}"""
        for name, server, port, panel in (("fr", *robots[:3]), ("gr", *robots[3:]))
    }
    file = folder / "private.yaml"
    file.write_text(
        f"""\
extends: {base}
hli: tcp/127.0.0.1:{hli}
sim: {transport}/{guarded}:{sim}
tcp_port: {tcp}
console_port: {console}
robots:{"".join(drivers.values())}
""",
        encoding="utf-8",
    )
    return file
