"""The lab cell of real processes that tests of several files share, one after the other.

To start a cell takes six seconds of processor time, and its end is waited for. Whoever needs other services, or a
cell that nobody has asked anything yet, starts one by `live_stack`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from last_use import LastUse
from live_stack import TIMEOUT_S, Stack, live_stack, mover

from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.services import console_service
from deltaq_emulator.states import KrcState
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase
from deltaq_testing.faults.panel import PanelClient, PanelError, recovery

APPROACH, OF_FASTEST = 0.2, 0.2
"""Share of what is missing to home that is asked for in a cycle, and of the largest increment."""
BLOCKED_CYCLES = 100
"""A robot that stands for so long on its way home waits until the other one is there."""


class SharedStack(Stack):
    """A cell that each test finds as if it had just been started, except for what its services have counted.

    Attributes:
        file: of the cell.
        recordings: where its console has recordings.
    """

    file: Path
    recordings: Path

    @classmethod
    def of(cls, stack: Stack, folder: Path) -> SharedStack:
        """Share this one; its files are in `folder`."""
        shared = cls(stack.launcher, stack.model, stack.record, stack._panel)
        shared.file, shared.recordings = folder / "private.yaml", folder
        services = stack.launcher.services
        console = console_service(stack.cell, str(shared.file), services, str(folder))
        # started by those who ask for them
        shared.on_demand = [mover(stack.cell), console]
        stack.launcher.services = (*services, *shared.on_demand)
        return shared

    def renewed(self) -> SharedStack:
        """Every service runs, no controller drives, robots are free and at home, and a record begins."""
        self.launcher.stop_service("mover")
        for service in self.launcher.services[: -len(self.on_demand)]:
            if self.launcher.children[service.name].status is not None:
                self.launcher.restart(service.name)
        self._set_free()
        self._bring_home()
        os.truncate(self.record, 0)
        self._unanswered_before += self.unanswered()
        return self

    def serve_console(self) -> str:
        """Start the console, if it does not run; where it is."""
        running = self.launcher.children.get("console")
        if running is None or running.status is not None:
            self.launcher.restart("console")
        while "console" not in self.launcher.ready:  # which a launch does not wait for
            assert self.launcher.wait(TIMEOUT_S) is not None
        return self.on_demand[1].endpoint

    def _set_free(self) -> None:
        """What an operator does: at the pendants, then a reset of whoever is held."""
        deadline = time.monotonic() + TIMEOUT_S
        while not self._is_free():
            assert time.monotonic() < deadline, self.phase()
            with suppress(RefusedError, ServiceUnreachableError), connect(self.cell, "test") as running:
                for name, robot in running.status().robots.items():
                    if robot.phase is Phase.HELD:
                        running.reset(name)
            self._pause()

    def _is_free(self) -> bool:
        for name in self.cell.robots:
            with PanelClient(self.cell, name) as panel:
                requests = recovery(panel.ask({"op": "status"})["state"])
                for request in requests:
                    panel.ask(request)
                if requests:  # asked again before it runs, it would begin to start anew
                    with suppress(PanelError):
                        panel.ask({"op": "await", "state": KrcState.RSI_RUNNING, "within_s": 3.0})
        with suppress(ServiceUnreachableError), connect(self.cell, "test") as running:
            robots = running.status().robots.values()
            return all(robot.phase is Phase.READY and robot.lease.holder is None for robot in robots)
        return False

    def _bring_home(self) -> None:
        waiting = list(self.model.robots)
        while waiting:
            name = waiting.pop(0)
            if not self._goes_home(name):
                waiting.append(name)

    def _goes_home(self, name: str) -> bool:
        """Bring a robot home; returns whether it got there, or stands before another that is in its way."""
        robot, stood, before = self.model.robots[name], 0, None
        fastest = OF_FASTEST * robot.max_velocity * self.cell.cycle_s
        with connect(self.cell, "test") as running, running.lease(name) as held:
            for state in held.states():
                missing = robot.home - np.array(state.q_cmd)
                if np.abs(missing).max() < 1e-5:
                    return True
                stood, before = stood + 1 if state.q_cmd == before else 0, state.q_cmd
                if stood == BLOCKED_CYCLES:
                    return False
                held.send(np.clip(APPROACH * missing, -fastest, fastest).tolist())
        raise AssertionError(f"the states of {name} have ended")


@contextmanager
def shared_cell(folder: Path) -> Iterator[SharedStack]:
    with live_stack(folder) as stack:
        yield SharedStack.of(stack, folder)


@pytest.fixture(scope="session")
def shared_stack(last_use: LastUse, tmp_path_factory: pytest.TempPathFactory) -> SharedStack:
    """The cell as the test before left it; most tests ask for one of those below."""
    return last_use.enter("shared_stack", shared_cell(tmp_path_factory.mktemp("shared")))


@pytest.fixture
def ready_stack(shared_stack: SharedStack) -> SharedStack:
    """The cell, with both robots at home and free."""
    return shared_stack.renewed()


@pytest.fixture
def moving_stack(ready_stack: SharedStack) -> SharedStack:
    """The cell, with a controller that swings A1 of the floor robot for ever."""
    ready_stack.launcher.restart("mover")
    ready_stack.wait_until_moving()
    return ready_stack
