"""Both halves of a cell on two sites, and controllers far away, as people start them: `deltaq up` at each site."""

import json
import os
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.child_process import Child
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.endpoint import Transport
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.given_token import CLIENT_TOKEN, OPERATOR_TOKEN
from deltaq_protocol.sayings import HLI, services
from deltaq_services.hli.client_roles import CONTROLLER_TOKEN
from studies.two_sites.packets import within as thread_within
from studies.two_sites.sites import Sites, within, write_cell

DELTAQ = (sys.executable, "-c", "from deltaq_deploy.command import main; main()")
_STARTS_WITHIN_S = 120.0
_ENDS_WITHIN_S = 30.0
_PANEL_WITHIN_S = 15.0


class SiteError(DeltaqError):
    """Something at a site did not do what it was started for."""


class Running:
    """One program at a site, with its lines as they come."""

    def __init__(
        self, name: str, namespace: str, command: Sequence[str], environment: dict[str, str]
    ) -> None:
        self._said = threading.Condition()
        self._child = Child(
            name, within(namespace, command), self._wake, self._wake, environment, is_ordinary=True
        )

    def wait_for(self, text: str, within_s: float = _STARTS_WITHIN_S) -> str:
        """The first line with this text.

        Raises:
            SiteError: if it ends, or that takes too long, with what it said.
        """

        def said() -> str | None:
            return next((line for line in list(self._child.lines) if text in line), None)

        with self._said:
            self._said.wait_for(lambda: said() is not None or self._child.exited.is_set(), within_s)
        line = said()
        if line is None:
            raise SiteError(f"{self._child.name} did not say {text!r} within {within_s:g} s:\n{self.text()}")
        return line

    def wait(self, within_s: float) -> int:
        """Its exit status.

        Raises:
            SiteError: if it goes on.
        """
        self._child.exited.wait(within_s)
        status = self._child.status
        if status is None:
            raise SiteError(f"{self._child.name} went on for {within_s:g} s:\n{self.text()}")
        return status

    @property
    def has_ended(self) -> bool:
        """Whether it has ended by itself."""
        return self._child.exited.is_set()

    def last_json(self) -> dict[str, Any]:
        """The last line that is a JSON object."""
        return dict(json.loads(next(line for line in reversed(self._child.lines) if line.startswith("{"))))

    def text(self) -> str:
        """Its last lines."""
        return "\n".join(list(self._child.lines)[-40:])

    def end(self) -> None:
        """Ask it to end, and kill it if it does not."""
        self._child.stop(_ENDS_WITHIN_S)

    def _wake(self, *_: object) -> None:
        with self._said:
            self._said.notify_all()


class SiteIdentities(NamedTuple):
    """Folders of the identities that each site has."""

    office: Path
    robots: Path


class TwoSites:
    """A cell that runs on two sites.

    Attributes:
        sites: the networks.
        file: the cell's, as both sites have it.
        cell: its description.
        identities: of its services.
    """

    def __init__(self, sites: Sites, folder: Path, transport: Transport, stack: ExitStack) -> None:
        self.sites, self._folder, self._stack = sites, folder, stack
        self.file = write_cell(folder, transport)
        self.cell: CellDescription = load_cell(str(self.file))
        self._controller_token = secrets.token_hex(16)
        self.identities = _identities_of_sites(self.file, self.cell, folder)
        tokens = {OPERATOR_TOKEN: secrets.token_hex(16), CONTROLLER_TOKEN: self._controller_token}
        self._environment = {"XDG_STATE_HOME": str(folder)}
        self._operator = tokens[OPERATOR_TOKEN]
        for name, token in tokens.items():
            file = folder / f"{name.lower()}.txt"
            file.touch(mode=0o600)
            file.write_text(token, encoding="ascii")
            self._environment[f"{name}_FILE"] = str(file)

    def up(self, namespace: str, only: str) -> Running:
        """`deltaq up --only` at a site, which has the identities of its own services alone."""
        command = (*DELTAQ, "up", "--cell", str(self.file), "--only", only, "--no-console")
        own = self.identities.robots if namespace == self.sites.robots else self.identities.office
        site = self.run(only, namespace, command, **{IDENTITY: str(own)})
        site.wait_for("is up: ")
        return site

    def controller(self, name: str, module: str, *arguments: str) -> Running:
        """Start a controller far away."""
        command = (sys.executable, "-m", module, "--url", self.cell.hli, *arguments)
        return self.run(name, self.sites.controller, command, **{CLIENT_TOKEN: self._controller_token})

    def run(self, name: str, namespace: str, command: Sequence[str], **environment: str) -> Running:
        """Start a program at a site; it is ended with the block."""
        running = Running(name, namespace, command, self._environment | environment)
        self._stack.callback(running.end)
        return running

    def ask(self, *arguments: str) -> dict[str, Any]:
        """What a command of an operator in the office prints with `--json`.

        Raises:
            SiteError: if it could not be done.
        """
        command = within(self.sites.office, [*DELTAQ, *arguments, "--url", self.cell.hli, "--json"])
        environment = os.environ | self._environment | {OPERATOR_TOKEN: self._operator}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if not done.stdout.startswith("{"):
            raise SiteError(
                f"`deltaq {' '.join(arguments)}`: status {done.returncode}: {done.stderr.strip()}"
            )
        return dict(json.loads(done.stdout))

    def get_ready(self) -> None:
        """Reset the robots that are held: telegrams may have been late while others started.

        Raises:
            SiteError: if one is held again at once.
        """
        for name, robot in self.ask("status")["robots"].items():
            if robot["phase"] == "held":
                self.ask("reset", "--robot", name)

    def panel(self, robot: str, **request: Any) -> dict[str, Any]:
        """What the emulated controller of a robot answers, at its own site.

        Raises:
            SiteError: if it does not, or what was awaited did not come.
        """
        driver = self.cell.robots[robot].driver
        assert isinstance(driver, RsiDescription)  # both robots of the lab cell are KUKAs
        assert driver.control_port is not None  # and emulated
        with thread_within(self.sites.robots):
            panel = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        with panel:
            panel.settimeout(_PANEL_WITHIN_S)
            panel.sendto(
                json.dumps(request or {"op": "status"}).encode(), (driver.address, driver.control_port)
            )
            answer: dict[str, Any] = json.loads(panel.recv(65536))
        if not answer["ok"]:
            raise SiteError(f"the emulated controller of {robot}: {answer['error']}")
        return answer


def _identities_of_sites(cell_file: Path, cell: CellDescription, folder: Path) -> SiteIdentities:
    """Make identities as the page tells, and give each site its own; the authority stays with neither.

    Raises:
        SiteError: if they cannot be made.
    """
    made = folder / "identities"
    command = [*DELTAQ, "keys", "--cell", str(cell_file), "--output", str(made)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SiteError(f"`deltaq keys`: {done.stderr.strip()}")
    of_sites = SiteIdentities(folder / "identities-office", folder / "identities-robots")
    for site in of_sites:
        site.mkdir(mode=0o700)
    for service in services(tuple(cell.robots)):
        (made / service).rename((of_sites.office if service == HLI else of_sites.robots) / service)
    return of_sites


@contextmanager
def two_sites(sites: Sites, folder: Path, transport: Transport = "tcp+udp") -> Iterator[TwoSites]:
    """Bring both halves up, the robots' first; they are ended in the reverse order.

    Raises:
        SiteError: if one does not come up.
    """
    with ExitStack() as stack:
        running = TwoSites(sites, folder, transport, stack)
        running.up(sites.robots, "robot-server,emulator,sim")
        running.up(sites.office, "hli")
        yield running
