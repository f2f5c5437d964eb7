"""Controllers ask for a playout buffer where the way there and back is longer than a cycle, and only there."""

from __future__ import annotations

from contextlib import ExitStack

import pytest
from served import Server
from small_cell import free_port

from deltaq_controllers.answers import lease
from deltaq_protocol import connect
from deltaq_protocol.endpoint import Endpoint
from deltaq_testing.impairment.process import RelayProcess
from deltaq_testing.impairment.relay import TrafficUnit
from deltaq_testing.impairment.stream import StreamFaults

pytestmark = pytest.mark.service


@pytest.mark.parametrize(("delay_s", "cycle_s"), [(0.0, 0.1), (0.07, 0.1), (0.03, 0.012)])
async def test_a_playout_buffer_is_asked_for_from_farther_away_than_a_cycle(
    delay_s: float, cycle_s: float
) -> None:
    with ExitStack() as served:
        server = served.enter_context(Server(cycle_s=cycle_s))
        away = Endpoint.parse(f"tcp/127.0.0.1:{free_port()}")
        relay = RelayProcess(away, Endpoint.parse(server.description.hli), TrafficUnit.BYTES)
        served.enter_context(relay).impair(StreamFaults(delay_s=delay_s))
        async with connect(str(away)) as cell, await lease(cell, "fr") as robot:
            before = None if robot.state is None else robot.state.cycle
            async for state in robot.states():
                if before is not None and state.cycle > before + 20:  # after the lease was granted
                    break
                before = state.cycle if before is None else before
    assert (state.playout is not None) == (2 * delay_s > cycle_s)
