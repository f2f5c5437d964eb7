"""`deltaq` for asyncio: the same names, with `async` and `await`.

async with aio.connect() as cell, cell.lease("fr") as robot:
await robot.move_to([-2.0, -0.6, -1.4, 2.4, 1.5, 0.3], speed=0.2)
"""

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from deltaq.motion import REACHED, InvalidMotionError, Motion, MotionError, checked, held, joint_path
from deltaq.tool import Tool
from deltaq_controllers.answers import Answers, own_view, view_ahead
from deltaq_controllers.interface import Controller
from deltaq_protocol import client
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.in_flight import InFlight, is_awaited
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import IoReply, Phase, RobotState, RobotSummary, Verdict
from deltaq_protocol.opening import Opening

_AT_REST = 2e-4
"""A robot is at rest when no joint moved by more from one state to the next [rad or m]."""
_NEAR = 2e-3
"""And when no measured joint is farther from the target [rad or m]."""


class Robot:
    """A robot whose lease this client holds. Leaving the block of `Cell.lease`, by any road, brings it to rest.

    Attributes:
        name: of the robot.
        summary: its joints, units and limits.
        leased: the same robot without motions, whose increments need not wait for their verdicts.
    """

    def __init__(self, cell: client.Cell, leased: LeasedRobot) -> None:
        self._cell, self.leased = cell, leased
        self.name: str = leased.name
        self.summary: RobotSummary = leased.summary

    @property
    def q(self) -> Array:
        """The newest measured configuration (n,) [rad or m].

        Raises:
            ServiceUnreachableError: no state has come yet.
        """
        return np.array(self._newest().q)

    @property
    def pose(self) -> Array:
        """`T_world_tool` (4, 4) at the newest measured configuration [m].

        Raises:
            ServiceUnreachableError: no state has come yet.
        """
        return self._tool().pose(self.q)

    def states(self) -> AsyncIterator[RobotState]:
        """States as they come, the newest only; see `deltaq_protocol.leased_robot.LeasedRobot.states`."""
        return self.leased.states()

    async def step(self, dq: ArrayLike, check: bool = True) -> Verdict:
        """Ask for an increment `dq` (n,) over one cycle [rad or m], and wait for its verdict.

        Args:
            dq: the increment.
            check: raise an error if it was not admitted as it is; otherwise the verdict says so.

        Raises:
            ValueError: the increment has another length, or is not finite.
            MotionError: it was limited, held or refused.
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        verdict = await self.leased.move(increment_of(self.summary, dq))
        return checked(self.name, verdict, self.summary) if check else verdict

    async def move_to(self, target: ArrayLike, speed: float = 0.2) -> RobotState:
        """Move to a configuration along a straight line in joint space; returns when the robot is at rest there.

        Args:
            target: (n,) configuration [rad or m].
            speed: share of the joints' greatest velocities, above 0, at most 1.

        Raises:
            ValueError: target or speed is out of its bounds.
            MotionError: the gate limited or held it before it was there; reason, value, bound and remedy are named.
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        path = np.asarray(target, dtype=np.float64)
        return await self._follow(lambda start: joint_path(self.name, self.summary, start, path), speed)

    async def home(self, speed: float = 0.2) -> RobotState:
        """Move to the home configuration of the cell's description; see `move_to`."""
        return await self.move_to(self.summary.home, speed)

    async def move_tool(
        self,
        dx: float = 0.0,
        dy: float = 0.0,
        dz: float = 0.0,
        speed: float = 0.2,
        axes: Literal["world", "tool"] = "world",
    ) -> RobotState:
        """Move the tool along a straight line without turning it; returns when the robot is at rest.

        Args:
            dx: displacement along the first of the axes [m].
            dy: along the second [m].
            dz: along the third [m].
            speed: share of the joints' greatest velocities, above 0, at most 1.
            axes: of the world, or of the tool.

        Raises:
            ValueError: the tool cannot go there, a displacement is not finite, or the speed out of its bounds.
            MotionError: the gate limited or held it.
        """
        way = np.array([dx, dy, dz], dtype=np.float64)
        if not np.isfinite(way).all():
            raise InvalidMotionError(f"dx, dy, dz: {way} is not finite")
        tool = self._tool()

        def line(start: Array) -> Array:
            turned = tool.pose(start)[:3, :3] @ way if axes == "tool" else way
            return tool.line(self.name, start, turned)

        return await self._follow(line, speed)

    async def run(self, controller: Controller) -> None:
        """Answer each state with `controller.increment(view)`, until that returns None or the task is cancelled.

        Raises:
            MotionError: the robot is held.
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
        """
        answers = Answers(self._cell, self.leased)
        async for state in self.leased.states():
            if state.phase is Phase.HELD:
                raise held(state)
            for cycle in await answers.due(state):
                asked: ArrayLike | None = controller.increment(answers.view(state))
                if asked is None:
                    return
                await answers.send(state, cycle, increment_of(self.summary, asked))

    async def run_routine(
        self, routine: str, equipment: str = "", *, first: int = 0, **numbers: float
    ) -> dict[str, Any]:
        """Run a routine on an item of the cell's equipment; it needs `deltaq[cell]`.

        Args:
            routine: its name (`deltaq routine list`), or a YAML file.
            equipment: the item; empty where the routine needs none.
            first: index of the step to begin with: the `place` of the report of a run that did not end.
            numbers: parameters of the routine.

        Returns:
            The report: `outcomes` has each step with its time, clearance and what the camera saw.

        Raises:
            RoutineError: the routine cannot be done here, or did not end as it should: its text says at which step and
                why, and its `report` has the rest.
            RefusedError: the lease was lost.
            ServiceUnreachableError: the server is gone.
            DeltaqError: `deltaq[cell]` is not installed.
        """
        try:
            from deltaq_controllers.routines.shell import LiveRoutine
        except ModuleNotFoundError as error:
            raise DeltaqError(f"{error.name} is not installed: pip install 'deltaq[cell]'") from None
        live = await asyncio.to_thread(LiveRoutine, self._cell, routine, equipment, self.name, first, numbers)
        await live.drive(self.leased)
        return live.done()

    async def io(self, outputs: Mapping[str, bool] | None = None) -> IoReply:
        """Set digital outputs, and read all; see `deltaq_protocol.leased_robot.LeasedRobot.io`."""
        return await self.leased.io(outputs)

    async def couple(self, tool: str | None) -> RobotState:
        """Couple a tool, or release it with None; see `deltaq_protocol.leased_robot.LeasedRobot.couple`."""
        return await self.leased.couple(tool)

    async def _follow(self, path: Callable[[Array], Array], speed: float) -> RobotState:
        motion: Motion | None = None
        in_flight, last = InFlight(), None
        before: RobotState | None = None
        async for state in self.leased.states():
            if state.phase is Phase.HELD:
                raise held(state)
            for verdict in await self.leased.new_verdicts():
                in_flight.take(verdict)
                if motion is not None:
                    motion.take(verdict)
            own = own_view(state, last) if is_awaited(state) else view_ahead(state, in_flight.ahead(state))
            if motion is None:
                start = path(own.q_cmd)
                motion = Motion(self.name, start, self.summary, self._cell.description.cycle_s, speed)
            dq = motion.increment(own.cycle, own.q_cmd)
            if dq is None:
                if before is not None and rests_at(motion.end, before, state):
                    return state
                before = state
            elif is_awaited(state):
                last = await self.leased.move(dq)
                motion.take(last)
            else:
                in_flight.sent(await self.leased.send(dq, state.cycle), dq, state.cycle)
        raise ServiceUnreachableError(f"{self.name}: its states have ended")

    def _newest(self) -> RobotState:
        state = self.leased.state
        if state is None:
            raise ServiceUnreachableError(f"{self.name}: no state has come yet; is the robot on?")
        return state

    def _tool(self) -> Tool:
        coupled = self.leased.state.coupled if self.leased.state else None
        return Tool(self._cell.description.kinematics[self.name], self.summary, coupled or "tool")


class Cell(client.Cell):
    """A connection to a running cell; see `deltaq_protocol.client.Cell` for all that it reads, stops and resets."""

    def lease(  # type: ignore[override] # its robots can do more
        self, robot: str, client: str | None = None, take: bool = False, playout: bool = False
    ) -> Opening[Robot]:
        """Hold the lease of a robot for the length of a block; see `deltaq_protocol.client.Cell.lease`."""
        return Opening(self._moved(super().lease(robot, client, take, playout)))

    @asynccontextmanager
    async def _moved(self, lease: Opening[LeasedRobot]) -> AsyncIterator[Robot]:
        async with lease as leased:
            yield Robot(self, leased)


def connect(
    address: str = client.DEFAULT_ADDRESS,
    name: str = "python",
    token: str | None = None,
    identity: str | os.PathLike[str] | None = None,
) -> Opening[Cell]:
    """Connect to a running cell for the length of a block; see `deltaq_protocol.client.connect`."""
    return client.connected(Cell, address, name, token, identity)


def increment_of(summary: RobotSummary, dq: ArrayLike) -> Array:
    """An increment (n,) as floats [rad or m].

    Raises:
        ValueError: it has another length than the robot, or is not finite.
    """
    increment: Array = np.asarray(dq, dtype=np.float64)
    if increment.shape != (len(summary.joints),):
        raise InvalidMotionError(f"dq: shape {increment.shape}, the robot has {len(summary.joints)} joints")
    if not np.isfinite(increment).all():
        raise InvalidMotionError(f"dq: {increment} is not finite")
    return increment


def rests_at(end: Array, before: RobotState, state: RobotState) -> bool:
    """Whether a robot stands at `end` (n,) [rad or m]: setpoint and drives are there, and nothing moved since `before`.

    The setpoint of a state can be older than the increments on their way: a slow robot is near it, and not yet there.
    """
    measured, setpoint = np.array(state.q), np.array(state.q_cmd)
    return bool(
        np.abs(setpoint - end).max() < REACHED
        and np.abs(measured - end).max() < _NEAR
        and np.abs(measured - np.array(before.q)).max() < _AT_REST
    )


__all__ = ["Cell", "MotionError", "Robot", "connect"]
