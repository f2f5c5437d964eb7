"""Bringing the robots of a running cell to rest."""

from __future__ import annotations

import time
from contextlib import suppress

from deltaq_cell.description import CellDescription
from deltaq_deploy.launch.cell_connection import Where, connect
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotStatus
from deltaq_protocol.reasons import ReasonCode

TIMEOUT_S = 5.0
POLL_S = 0.05
STILL = 1e-5
"""Change of a joint between two states that counts as standing still [rad or m]."""


def bring_to_rest(cell: CellDescription, client: str) -> None:
    """Stop every robot of a cell through its HLI, and wait until each is at rest.

    Args:
        cell: the cell's description.
        client: name of the client that asks.

    Raises:
        ServiceUnreachableError: if the HLI does not answer, or a robot is not at rest within `TIMEOUT_S`.
    """
    deadline = time.monotonic() + TIMEOUT_S
    # whatever description it has read: a stop is for everybody
    with connect(Where(cell.hli, cell.cell), client) as running:
        with suppress(
            RefusedError
        ):  # not confirmed: what is asked for stands, and what comes of it is seen below
            running.stop()
        before: dict[str, RobotStatus] = {}
        while True:
            robots = running.status().robots
            moving = [name for name, robot in robots.items() if not rests(before.get(name), robot)]
            if not moving:
                return
            if time.monotonic() > deadline:
                raise ServiceUnreachableError(f"{', '.join(moving)} not at rest {TIMEOUT_S:g} s after a stop")
            before = robots
            time.sleep(POLL_S)


def rests(before: RobotStatus | None, now: RobotStatus) -> bool:
    """Held, and measured at one place twice: a robot is held from its stop on, and then still brakes."""
    if now.phase is Phase.OFFLINE or now.reason is ReasonCode.KRC_LOST:
        return True  # it is silent: there is nothing to wait for
    if now.phase is not Phase.HELD or before is None or before.cycle == now.cycle:
        return False
    return all(abs(q - q_before) < STILL for q, q_before in zip(now.q, before.q, strict=True))
