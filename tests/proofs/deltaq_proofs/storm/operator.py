"""Who brings the robot back to its work whenever an attack has stopped it, as somebody at the cell would."""

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.cell_connection import connect
from deltaq_emulator.states import KrcState
from deltaq_proofs.storm.forger import Worker
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase
from deltaq_testing.faults.panel import PanelClient, PanelError, recovery

_LOOK_S = 0.25
_RESTART_LOOKS = 120
"""Looks after which the program on the KRC is started anew, so that sessions begin while the storm goes on."""


class StormOperator(Worker):
    """Looks at pendant and phase in a thread of its own; a context manager.

    Args:
        cell: the running cell.
        robot: whose KRC and phase.
    """

    def __init__(self, cell: CellDescription, robot: str) -> None:
        super().__init__("operator")
        self._cell, self._robot = cell, robot

    def work(self) -> None:
        """Look again and again."""
        looks = 0
        with PanelClient(self._cell, self._robot) as panel, connect(self._cell, "operator") as running:
            while not self.ended.wait(_LOOK_S):
                looks += 1
                try:
                    state = panel.ask({"op": "status"})["state"]
                    again = looks % _RESTART_LOOKS == 0 and state == KrcState.RSI_RUNNING
                    for request in recovery(state) or ([{"op": "restart"}] if again else []):
                        panel.ask(request)
                    if running.status().robots[self._robot].phase is Phase.HELD:
                        running.reset(self._robot)
                except (PanelError, RefusedError, ServiceUnreachableError):
                    continue  # asked again at the next look
