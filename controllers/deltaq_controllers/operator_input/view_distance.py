"""The view distance of the camera that watches a robot, changed in steps while that robot is driven."""

from __future__ import annotations

import asyncio

import numpy as np

from deltaq_cell.roles import RoleError, camera_roles
from deltaq_controllers.live import cell_model
from deltaq_protocol.client import Cell
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.pad_layout import VIEW_RANGE_M


def stepped(now_m: float, step_m: float) -> float:
    """The view distance a step on from `now_m`, in whole centimetres within `VIEW_RANGE_M` [m]."""
    least_m, most_m = VIEW_RANGE_M
    return round(min(most_m, max(least_m, now_m + step_m)), 2)


class AskedViewDistance:
    """Asks a robot's follower for another view distance, outside the control loop.

    Args:
        cell: connection to the cell.
        robot: the robot that is watched.

    Attributes:
        status: result of the last step, for the operator.
    """

    def __init__(self, cell: Cell, robot: str) -> None:
        self._cell, self._robot = cell, robot
        self._asked_m: float | None = None
        self._task: asyncio.Task[None] | None = None
        self.status = ""
        described = cell_model(cell.description)
        try:
            self._camera = camera_roles(described.description, leader=robot).follower
        except RoleError:
            self._camera = ""
            return
        self._follower = described.robots[self._camera]

    def change(self, step_m: float) -> None:
        """Look from nearer, or from farther away [m]; nothing in a cell where no camera watches the robot."""
        now_m = self._now_m() if self._camera else None
        if now_m is None:
            self.status = f"no camera watches {self._robot}"
            return
        self._asked_m = stepped(now_m, step_m)
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._ask())

    def _now_m(self) -> float | None:
        """The distance that is asked for now, else the one from lens to tool; None if neither robot is seen."""
        if self._asked_m is not None:
            return self._asked_m
        follower, watched = self._cell.state(self._camera), self._cell.state(self._robot)
        if follower is None or watched is None:
            return None
        if follower.view is not None and follower.view.distance_m is not None:
            return follower.view.distance_m
        lens = self._follower.camera_pose(follower.q)[:3, 3]
        return float(np.linalg.norm(np.array(watched.tool.position) - lens))

    async def _ask(self) -> None:
        """Ask for the newest step; those that come meanwhile are asked for at once."""
        while (asked_m := self._asked_m) is not None:
            try:
                reply = await self._cell.view(self._camera, distance_m=asked_m)
            except DeltaqError as error:
                self.status = f"view: {error}"
                self._asked_m = None
                return
            self.status = f"view {asked_m:.2f} m" + (
                "" if reply.holder else f", no follower runs on {self._camera}"
            )
            if self._asked_m == asked_m:
                self._asked_m = None
