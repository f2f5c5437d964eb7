"""Two sites and a controller far away, on one machine: three networks of their own and the links between them.

controller ── a wide-area network ── office ── a network that can be cut ── robots
              packets late and lost    HLI                                   SIM, Robot Servers, emulators
"""

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from deltaq_protocol.endpoint import Transport
from deltaq_protocol.errors import DeltaqError
from studies.two_sites.packets import DEVICE

ROBOTS_ADDRESS, OFFICE_ADDRESS = "10.77.0.1", "10.77.0.2"
HLI_ADDRESS, CONTROLLER_ADDRESS = "10.77.1.1", "10.77.1.2"
_CABLE = "cable"


class SitesError(DeltaqError):
    """Networks of their own are not allowed here."""


@dataclass(frozen=True)
class Sites:
    """The names of the three networks."""

    robots: str
    office: str
    controller: str

    @property
    def all(self) -> tuple[str, str, str]:
        """All three."""
        return self.robots, self.office, self.controller

    def cut(self) -> None:
        """Cut the cable between office and robots: nothing passes, and nobody is told."""
        ip("-n", self.office, "link", "set", _CABLE, "down")

    def mend(self) -> None:
        """Mend it."""
        ip("-n", self.office, "link", "set", _CABLE, "up")

    def connect_wide_area(self) -> None:
        """Give the devices of a `PacketLink` between controller and office their addresses."""
        for name, address in ((self.office, HLI_ADDRESS), (self.controller, CONTROLLER_ADDRESS)):
            ip("-n", name, "address", "add", f"{address}/24", "dev", DEVICE)
            ip("-n", name, "link", "set", DEVICE, "up")


def within(namespace: str, command: Sequence[str]) -> list[str]:
    """A command that runs in a network."""
    return ["ip", "netns", "exec", namespace, *command]


def ip(*arguments: str) -> None:
    """Run `ip`.

    Raises:
        SitesError: if it fails.
    """
    if shutil.which("ip") is None:
        raise SitesError("there is no `ip` here; install iproute2")
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SitesError(
            f"`ip {' '.join(arguments)}`: {done.stderr.strip()}; networks of their own need root"
        )


@contextmanager
def sites() -> Iterator[Sites]:
    """Make the networks; they are gone after the block.

    Raises:
        SitesError: if that is not allowed here.
    """
    prefix = f"deltaq-{os.getpid()}"
    made = Sites(f"{prefix}-robots", f"{prefix}-office", f"{prefix}-controller")
    with ExitStack() as stack:
        for name in made.all:
            ip("netns", "add", name)
            stack.callback(ip, "netns", "delete", name)
            ip("-n", name, "link", "set", "lo", "up")
        ip(
            "-n",
            made.robots,
            "link",
            "add",
            _CABLE,
            "type",
            "veth",
            "peer",
            "name",
            _CABLE,
            "netns",
            made.office,
        )
        for name, address in ((made.robots, ROBOTS_ADDRESS), (made.office, OFFICE_ADDRESS)):
            ip("-n", name, "address", "add", f"{address}/24", "dev", _CABLE)
            ip("-n", name, "link", "set", _CABLE, "up")
        yield made


def write_cell(folder: Path, transport: Transport = "tcp+udp", base: str = "lab") -> Path:
    """Write the cell's file as both sites have it: Robot Servers and SIM with the robots, the HLI in the office.

    Args:
        folder: to write it to.
        transport: of the way from controllers to the HLI.
        base: the cell that it extends.
    """
    file = folder / "two-sites.yaml"
    file.write_text(
        f"""\
extends: {base}
# where the robots are
sim: tls/{ROBOTS_ADDRESS}:7450
robots:
  fr: {{server: tls/{ROBOTS_ADDRESS}:7451}}
  gr: {{server: tls/{ROBOTS_ADDRESS}:7452}}
# in the office
hli: {transport}/{HLI_ADDRESS}:7447
clients_need_tokens: true
""",
        encoding="utf-8",
    )
    return file
