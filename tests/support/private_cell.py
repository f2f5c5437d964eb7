"""The lab cell on ports of its own, so that a test disturbs nobody."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from pathlib import Path


def free_ports(count: int) -> list[int]:
    """Ports of the loopback that nobody listens on, neither over TCP nor over UDP."""
    ports: list[int] = []
    with ExitStack() as held:
        while len(ports) < count:
            tcp = held.enter_context(socket.socket())
            udp = held.enter_context(socket.socket(type=socket.SOCK_DGRAM))
            tcp.bind(("127.0.0.1", 0))
            port = tcp.getsockname()[1]
            try:
                udp.bind(("127.0.0.1", port))
            except OSError:
                continue
            ports.append(port)
    return ports


def write_private_cell(folder: Path, base: str = "lab", guarded: str = "127.0.0.1") -> Path:
    """Write a cell file that differs from a shipped cell by its ports, and by where the guarded realm listens."""
    hli, sim, tcp, console, *robots = free_ports(10)
    drivers = {
        name: f"""
  {name}:
    server: tcp/{guarded}:{server}
    driver: {{port: {port}, control_port: {panel}}}"""
        for name, server, port, panel in (("fr", *robots[:3]), ("gr", *robots[3:]))
    }
    file = folder / "private.yaml"
    file.write_text(
        f"""\
extends: {base}
hli: tcp/127.0.0.1:{hli}
sim: tcp/{guarded}:{sim}
tcp_port: {tcp}
console_port: {console}
robots:{"".join(drivers.values())}
""",
        encoding="utf-8",
    )
    return file
