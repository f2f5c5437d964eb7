"""Requests to an emulated controller's panel: faults, and the operator's steps back to a running program."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_deploy.launch.cell_connection import connect
from deltaq_emulator.catalogue import TEXTS, Code
from deltaq_emulator.states import KrcState
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.faults.catalogue import CATALOGUE, AskPanel, Fault, UnknownFaultError
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

_TIMEOUT_S = 5.0
"""Longer than anything is awaited."""
_MAX_ANSWER_BYTES = 65_535

_WAYS_BACK: dict[str, tuple[dict[str, Any], ...]] = {
    KrcState.DRIVES_OFF: ({"op": "drives", "on": True}, {"op": "restart"}),
    KrcState.STOPPED: ({"op": "acknowledge"}, {"op": "restart"}),
    KrcState.READY: ({"op": "restart"},),
    KrcState.RSI_ON: ({"op": "confirm"},),
    KrcState.RSI_RUNNING: (),
    KrcState.MOTION_ENDED: ({"op": "restart"},),
}


_PROTESTS = tuple(
    TEXTS[code].partition("{")[0]
    for code in (
        Code.CORRECTION_MONITOR,
        Code.SOFTWARE_LIMIT,
        Code.GEAR_TORQUE,
        Code.KINETIC_ENERGY,
        Code.T1_SPEED,
    )
)
"""How messages begin with which a controller refuses a motion that it was sent."""


class PanelError(DeltaqError):
    """The panel refused a request."""


def recovery(state: str) -> tuple[dict[str, Any], ...]:
    """What an operator does at a controller in `state` until its program runs again."""
    return _WAYS_BACK[state]


def pendant_message(message: str | None) -> str | None:
    """The message on the pendant, if it means that the controller refused a setpoint."""
    return message if message is not None and any(text in message for text in _PROTESTS) else None


def describe(requests: tuple[dict[str, Any], ...]) -> str:
    """These requests in words."""
    names = ("drives on" if request["op"] == "drives" else str(request["op"]) for request in requests)
    return "KRC: " + " and ".join(names)


class PanelClient:
    """The panel of a robot's emulated controller over UDP; a context manager.

    Args:
        cell: description of the running cell.
        robot: its name.

    Raises:
        UnknownFaultError: if the robot has no panel.
    """

    def __init__(self, cell: CellDescription, robot: str) -> None:
        driver = cell.robots[robot].driver
        if not isinstance(driver, RsiDescription) or driver.control_port is None:
            raise UnknownFaultError(
                f"robots.{robot} has no emulated controller with a panel; give its driver a `control_port`, or "
                "name another robot"
            )
        self._robot = robot
        self._address = (driver.address, driver.control_port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(_TIMEOUT_S)

    def __enter__(self) -> PanelClient:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request and return the panel's status after it.

        Raises:
            ServiceUnreachableError: if no panel answers.
            PanelError: if it refuses.
        """
        self._socket.sendto(json.dumps(request).encode(), self._address)
        try:
            answer = self._socket.recv(_MAX_ANSWER_BYTES)
        except OSError as error:
            host, port = self._address
            raise ServiceUnreachableError(
                f"no emulated controller of {self._robot} at {host}:{port}; is the cell up (`deltaq up`)?"
            ) from error
        return checked(answer)


def checked(answer: bytes) -> dict[str, Any]:
    """The status that a panel answered with.

    Raises:
        PanelError: if it refused.
    """
    status: dict[str, Any] = json.loads(answer)
    if not status["ok"]:
        raise PanelError(f"the emulated controller refused: {status['error']}")
    return status


def load_rsi_cell(cell_name: str | Path, robot: str | None = None) -> LoadedCell:
    """Read a cell.

    Args:
        cell_name: its name or file.
        robot: one that it has to have.

    Raises:
        UnknownFaultError: if a robot has no KRC that could be emulated, or there is no such robot.
    """
    loaded = LoadedCell.load(cell_name)
    description = loaded.model.description
    for name, one in description.robots.items():
        if not isinstance(one.driver, RsiDescription):
            raise UnknownFaultError(
                f"robots.{name}.driver is {one.driver.kind!r}; faults are injected in cells whose robots are "
                "all driven over RSI: use such a cell, e.g. --cell lab"
            )
    must_have(description, robot)
    return loaded


def must_have(cell: CellDescription, robot: str | None) -> None:
    """Refuse a robot that a cell does not have; None is accepted.

    Raises:
        UnknownFaultError: there is no such robot.
    """
    if robot is not None and robot not in cell.robots:
        raise UnknownFaultError(f"no robot {robot!r} in cell {cell.cell}; it has {', '.join(cell.robots)}")


class Injected(BaseModel, frozen=True):
    """The result of an injected fault: the robot at its end.

    Attributes:
        phase, reason: as the HLI shows them while the fault stands.
        krc_state, krc_message: of the emulated controller.
    """

    fault: str
    robot: str
    phase: Phase
    reason: ReasonCode | None
    krc_state: str
    krc_message: str | None


def inject(fault: Fault, cell: CellDescription, robot: str, for_s: float) -> Injected:
    """Inject a fault, wait, read the robot's state, and end the fault.

    Args:
        fault: one that is injectable.
        cell: description of the running cell.
        robot: whose controller is affected.
        for_s: duration of the fault [s].

    Raises:
        UnknownFaultError: if the fault is none of the emulated controller's.
        ServiceUnreachableError: if the cell is not up.
        PanelError: if the emulated controller refuses.
    """
    if not isinstance(fault.action, AskPanel):
        possible = ", ".join(row.name for row in CATALOGUE if row.injectable)
        raise UnknownFaultError(
            f"{fault.name} cannot be injected into a running cell; allowed are {possible}; `deltaq fault table "
            f"{fault.name}` shows what it does"
        )
    with PanelClient(cell, robot) as panel, connect(cell, "deltaq fault") as running:
        panel.ask(fault.action.request)
        try:
            time.sleep(for_s)
            status = running.status().robots[robot]
        finally:
            seen = panel.ask(fault.lift or {"op": "status"})
    return Injected(
        fault=fault.name,
        robot=robot,
        phase=status.phase,
        reason=status.reason,
        krc_state=seen["state"],
        krc_message=seen["message"],
    )
