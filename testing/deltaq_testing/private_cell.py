"""A cell on ports of its own, so that tests do not disturb each other."""

import contextlib
import fcntl
import functools
import itertools
import os
import socket
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from deltaq_cell.description import LOCAL, RsiDescription
from deltaq_cell.load import find_cell, load_cell
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import DeltaqError

_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


FIRST_PORT = 15_000
"""Ports from here on are drawn from, to below those that the system gives to sockets that ask for none."""
PORTS_A_BLOCK = 200


def free_ports(count: int) -> list[int]:
    """Free ports of the loopback, for TCP and UDP.

    They are outside the system's range for client sockets: otherwise a service that connects while the cell starts
    could get one of them. Each process draws from a block of its own.
    """
    return list(itertools.islice((port for port in _ports() if _is_free(port)), count))


@functools.cache
def _ports() -> Iterator[int]:
    """The ports of this process's block, round and round."""
    ephemeral = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    # a system whose range for client sockets has all ports leaves none that are safe
    end = max(ephemeral, 2 * FIRST_PORT) - PORTS_A_BLOCK
    for first in range(FIRST_PORT, end, PORTS_A_BLOCK):
        if _claims(first) is not None:
            return itertools.cycle(range(first, first + PORTS_A_BLOCK))
    raise DeltaqError(f"every block of ports from {FIRST_PORT} to {end} is claimed; end a test that runs")


@functools.cache
def _claims(first: int) -> int | None:
    """A lock on a block of ports, kept until this process ends; None if another process has it."""
    folder = Path(tempfile.gettempdir()) / f"deltaq-ports-{os.geteuid()}"
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    about = folder.lstat()  # a link would lead wherever its owner wants
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.geteuid() or about.st_mode & _OTHERS_WRITE:
        raise DeltaqError(
            f"{folder} is no folder that only user {os.geteuid()} may write to; remove it, or let TMPDIR name another"
        )
    lock = os.open(folder / str(first), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(lock)
        return None
    return lock


def _is_free(port: int) -> bool:
    with socket.socket() as tcp, socket.socket(type=socket.SOCK_DGRAM) as udp:
        # a connection that has ended lately does not listen
        tcp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tcp.bind(("127.0.0.1", port))
            udp.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def write_private_cell(folder: Path, base: str | Path = "lab", encrypted_at: str | None = None) -> Path:
    """Write a cell file that differs from another cell by its ports, and by where the guarded realm listens.

    Args:
        folder: to write it to.
        base: name or file of the other cell.
        encrypted_at: address of SIM and Robot Servers, over TLS; None: they listen at Unix sockets.

    Raises:
        CellError: there is no such cell.
        DeltaqError: every port is claimed, or the folder of the claims is not this user's.
    """
    file = find_cell(base)
    description = load_cell(file)
    rsi = {name: isinstance(robot.driver, RsiDescription) for name, robot in description.robots.items()}

    def guarded(port: int) -> str:
        return LOCAL if encrypted_at is None else f"tls/{encrypted_at}:{port}"

    hli, sim, tcp, console, *ports = free_ports(4 + sum(3 if has_krc else 1 for has_krc in rsi.values()))
    robots: dict[str, dict[str, Any]] = {}
    for name, has_krc in rsi.items():
        robots[name] = {"server": guarded(ports.pop(0))}
        if has_krc:
            robots[name] |= {"driver": {"port": ports.pop(0), "control_port": ports.pop(0)}}
    cell = {
        "extends": str(file.resolve()),
        "hli": f"{Endpoint.parse(description.hli).transport}/127.0.0.1:{hli}",
        "sim": guarded(sim),
        "tcp_port": tcp,
        "console_port": console,
        "robots": robots,
    }
    private = folder / "private.yaml"
    private.write_text(yaml.safe_dump(cell, sort_keys=False), encoding="utf-8")
    return private
