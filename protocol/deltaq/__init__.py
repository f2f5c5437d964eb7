"""Drive the robots of a running cell from Python.

    import deltaq

    with deltaq.connect() as cell, cell.lease("fr") as robot:
        robot.move_to([-2.0, -0.6, -1.4, 2.4, 1.5, 0.3], speed=0.2)
        robot.move_tool(dz=-0.05)
        verdict = robot.step([0.001, 0, 0, 0, 0, 0])

Every increment passes the gate of the cell. `deltaq.aio` has the same names for asyncio. `Gate` is the gate by itself,
for any arm and without a cell (`deltaq.gate`); it needs `deltaq[cell]`, and is loaded when it is first named.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal

from numpy.typing import ArrayLike

from deltaq import aio
from deltaq.aio import increment_of
from deltaq.motion import MotionError, checked
from deltaq_controllers.interface import Controller, RobotView, View
from deltaq_protocol import blocking
from deltaq_protocol.arrays import Array
from deltaq_protocol.blocking import Background, BlockingCell, BlockingOpening, BlockingRobot
from deltaq_protocol.client import DEFAULT_ADDRESS
from deltaq_protocol.errors import DeltaqError, RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import RobotState, Verdict
from deltaq_protocol.opening import Opening

if TYPE_CHECKING:
    from deltaq.gate import Gate, Step
    from deltaq.obstacles import Box, Capsule, Cylinder, GateError, Mesh, Sphere


class Robot(BlockingRobot):
    """A robot whose lease this client holds. Leaving the block of `Cell.lease`, by any road, brings it to rest.

    Methods without a text of their own are described in `deltaq.aio.Robot`.
    """

    def __init__(
        self,
        robot: aio.Robot,
        background: Background,
        states: Callable[[], Iterator[RobotState]],
        close: Callable[[], None],
    ) -> None:
        super().__init__(robot.leased, background, states, close)
        self._moving = robot

    @property
    def q(self) -> Array:
        """The newest measured configuration (n,) [rad or m]; see `deltaq.aio.Robot.q`."""
        return self._moving.q

    @property
    def pose(self) -> Array:
        """`T_world_tool` (4, 4) at the newest measured configuration [m]; see `deltaq.aio.Robot.pose`."""
        return self._moving.pose

    def step(self, dq: ArrayLike, check: bool = True) -> Verdict:
        """Ask for an increment `dq` (n,) over one cycle [rad or m]; see `deltaq.aio.Robot.step`."""
        verdict = self.move(increment_of(self.summary, dq))
        return checked(self.name, verdict, self.summary) if check else verdict

    def move_to(self, target: ArrayLike, speed: float = 0.2) -> RobotState:
        """Move to a configuration `target` (n,) [rad or m]; see `deltaq.aio.Robot.move_to`."""
        return self._background.run(self._moving.move_to(target, speed))

    def home(self, speed: float = 0.2) -> RobotState:
        """Move to the home configuration; see `deltaq.aio.Robot.home`."""
        return self._background.run(self._moving.home(speed))

    def move_tool(
        self,
        dx: float = 0.0,
        dy: float = 0.0,
        dz: float = 0.0,
        speed: float = 0.2,
        axes: Literal["world", "tool"] = "world",
    ) -> RobotState:
        """Move the tool along a straight line [m]; see `deltaq.aio.Robot.move_tool`."""
        return self._background.run(self._moving.move_tool(dx, dy, dz, speed, axes))

    def run_routine(
        self, routine: str, equipment: str = "", *, first: int = 0, **numbers: float
    ) -> dict[str, Any]:
        """Run a routine on an item of the cell's equipment; see `deltaq.aio.Robot.run_routine`."""
        return self._background.run(self._moving.run_routine(routine, equipment, first=first, **numbers))

    def run(self, controller: Controller) -> None:
        """Answer each state with `controller.increment(view)`, in another thread; see `deltaq.aio.Robot.run`."""
        self._background.run(self._moving.run(controller))


class Cell(BlockingCell):
    """A connection to a running cell; see `deltaq_protocol.client.Cell` for all that it reads, stops and resets."""

    def lease(
        self, robot: str, client: str | None = None, take: bool = False, playout: bool = False
    ) -> BlockingOpening[Robot]:
        """Hold the lease of a robot for the length of a block; see `deltaq_protocol.client.Cell.lease`."""
        assert isinstance(self._cell, aio.Cell)  # `connect` made it
        lease = self._cell.lease(robot, client, take, playout)
        opening: BlockingOpening[Robot] = BlockingOpening(self._led(lease, close=lambda: opening.close()))
        return opening

    @contextmanager
    def _led(self, lease: Opening[aio.Robot], close: Callable[[], None]) -> Iterator[Robot]:
        with self._background.entered(lease) as robot:
            yield Robot(robot, self._background, lambda: self.states(robot.name), close)


def connect(
    address: str = DEFAULT_ADDRESS,
    client: str = "python",
    token: str | None = None,
    identity: str | os.PathLike[str] | None = None,
) -> BlockingOpening[Cell]:
    """Connect to a running cell for the length of a block; see `deltaq_protocol.client.connect`."""
    return blocking.connected(aio.connect(address, client, token, identity), Cell)


_LOADED_WHEN_NAMED = {"Gate": "deltaq.gate", "Step": "deltaq.gate"} | dict.fromkeys(
    ("Box", "Capsule", "Cylinder", "GateError", "Mesh", "Sphere"), "deltaq.obstacles"
)


def __getattr__(name: str) -> Any:
    if name not in _LOADED_WHEN_NAMED:
        raise AttributeError(f"module 'deltaq' has no attribute {name!r}")
    try:
        return getattr(import_module(_LOADED_WHEN_NAMED[name]), name)
    except ModuleNotFoundError as error:
        raise DeltaqError(f"{error.name} is not installed: pip install 'deltaq[cell]'") from None


__all__ = [
    "Box",
    "Capsule",
    "Cell",
    "Controller",
    "Cylinder",
    "DeltaqError",
    "Gate",
    "GateError",
    "Mesh",
    "MotionError",
    "RefusedError",
    "Robot",
    "RobotView",
    "ServiceUnreachableError",
    "Sphere",
    "Step",
    "View",
    "connect",
]
