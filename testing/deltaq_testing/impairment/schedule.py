"""Impair a link for a while, as `deltaq fault impair` does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from deltaq_emulator.faults import LinkFaults
from deltaq_protocol.endpoint import Endpoint
from deltaq_testing.impairment.relay import TrafficUnit, relay
from deltaq_testing.impairment.stream import StreamFaults


async def impair_for_a_while(
    listen: Endpoint,
    to: Endpoint,
    unit: TrafficUnit,
    faults: StreamFaults | LinkFaults,
    say: Callable[[str], None],
    *,
    after_s: float = 0.0,
    for_s: float | None = None,
    duration_s: float | None = None,
    seed: int = 0,
) -> None:
    """Carry a link through a relay, with faults for a while.

    Args:
        listen: address to which one of the two parties connects or sends.
        to: address at which the other one listens.
        unit: the unit that faults affect.
        faults: of the link.
        say: called with each event.
        after_s: time until the faults begin.
        for_s: duration of the faults; None for as long as the relay works.
        duration_s: duration of the relay; None for ever.
        seed: of the random numbers.

    Raises:
        InvalidEndpointError: if the transport of an endpoint is not that of the unit.
        ServiceUnreachableError: if `listen` cannot be listened on.
    """
    async with relay(listen, to, unit, seed) as running:
        say(f"carries {unit} from {listen} to {to}; Ctrl-C ends it")
        try:
            async with asyncio.timeout(duration_s):
                await asyncio.sleep(after_s)
                running.impair(faults)
                say(f"impaired: {faults.model_dump_json(exclude_defaults=True)}")
                await asyncio.sleep(for_s if for_s is not None else float("inf"))
                running.impair(unit.faults())
                say("whole again")
                await asyncio.Event().wait()
        except TimeoutError:
            return
