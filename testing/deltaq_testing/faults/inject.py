"""A fault in a running emulated cell, through the panel of a robot's emulated controller."""

from __future__ import annotations

import time

from pydantic import BaseModel, ConfigDict

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.cell_connection import connect
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.faults.actions import AskPanel
from deltaq_testing.faults.catalogue import CATALOGUE, Fault, UnknownFaultError
from deltaq_testing.faults.panel import PanelClient


class Injected(BaseModel):
    """A fault that was injected, and the robot at its end.

    Attributes:
        phase, reason: as the HLI shows them while the fault stands.
        krc_state, krc_message: of the emulated controller.
    """

    model_config = ConfigDict(frozen=True)

    fault: str
    robot: str
    phase: Phase
    reason: ReasonCode | None
    krc_state: str
    krc_message: str | None


def inject(fault: Fault, cell: CellDescription, robot: str, for_s: float) -> Injected:
    """Inject a fault, wait, look, and lift it.

    Args:
        fault: one that is injectable.
        cell: description of the running cell.
        robot: whose controller suffers it.
        for_s: how long it stands before it is looked at and lifted.

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
