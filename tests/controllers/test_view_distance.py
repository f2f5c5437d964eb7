"""The view distance in steps: what is asked of whoever follows the robot that is driven."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest
from first_cycles import QuietCell, Waits

from deltaq_controllers.operator_input.view_distance import AskedViewDistance, stepped
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import RobotState, ViewReply, ViewWish
from deltaq_protocol.pad_layout import VIEW_RANGE_M, VIEW_STEP_M
from deltaq_protocol.reasons import ReasonCode


class WatchedCell(QuietCell):
    """Takes requests for another view, as the HLI does."""

    def __init__(self, name: str = "lab", holder: str | None = "follower") -> None:
        super().__init__(name, Waits())
        self.asked: list[tuple[str, float | None]] = []
        self.holder, self.refuses = holder, False
        self.wish: ViewWish | None = None

    def state(self, robot: str) -> RobotState:
        return super().state(robot).model_copy(update={"view": self.wish if robot == "fr" else None})

    async def view(self, robot: str, distance_m: float | None = None, *_: Any, **__: Any) -> ViewReply:
        await asyncio.sleep(0)
        if self.refuses:
            raise RefusedError(ReasonCode.NOT_PERMITTED, "a controller's token is needed")
        self.asked.append((robot, distance_m))
        self.wish = ViewWish(distance_m=distance_m)
        return ViewReply(robot=robot, view=self.wish, holder=self.holder)


async def settled() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


def test_a_step_stays_within_the_range_of_the_pad() -> None:
    least_m, most_m = VIEW_RANGE_M
    assert stepped(1.234, VIEW_STEP_M) == pytest.approx(1.33)
    assert stepped(most_m - 0.01, VIEW_STEP_M) == most_m
    assert stepped(least_m, -VIEW_STEP_M) == least_m


async def test_the_first_step_goes_from_the_distance_that_is_seen_and_the_next_from_what_was_asked() -> None:
    cell = WatchedCell()
    view = AskedViewDistance(cell, "gr")
    lens = cell.models["fr"].camera_pose(cell.places["fr"])[:3, 3]
    seen_m = float(np.linalg.norm(np.array(cell.state("gr").tool.position) - lens))
    view.change(-VIEW_STEP_M)
    await settled()
    assert cell.asked == [("fr", pytest.approx(seen_m - VIEW_STEP_M, abs=0.006))]
    first_m = cell.wish.distance_m if cell.wish else None
    view.change(VIEW_STEP_M)
    view.change(VIEW_STEP_M)
    await settled()
    assert first_m is not None
    assert cell.asked[-1] == ("fr", pytest.approx(first_m + 2 * VIEW_STEP_M))
    assert view.status == f"view {cell.asked[-1][1]:.2f} m"


async def test_it_is_said_that_nobody_follows_that_it_is_refused_and_that_no_camera_watches() -> None:
    cell = WatchedCell(holder=None)
    view = AskedViewDistance(cell, "gr")
    view.change(VIEW_STEP_M)
    await settled()
    assert view.status.endswith("m, nobody follows with fr")
    cell.refuses = True
    view.change(VIEW_STEP_M)
    await settled()
    assert "token" in view.status
    alone = AskedViewDistance(cell, "fr")
    alone.change(VIEW_STEP_M)
    assert alone.status == "no camera watches fr"
