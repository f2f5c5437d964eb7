"""What tells one moment of RSI's wire from another."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deltaq_proofs.model_checker.one_joint import CYCLE_S, IPOC_STEP
from deltaq_proofs.model_checker.ranks import ranks
from deltaq_proofs.model_checker.rsi_line import Own, RsiLine
from deltaq_protocol.arrays import Array
from deltaq_protocol.rsi import KrcTelegram

_TICKS_APART = 4
"""No age is judged that is greater, in cycles."""
_IPOCS_APART = 110
"""Nor a distance of two IPOCs, in cycles."""
_DELAYS_APART = 1
"""Of late packets it is asked only whether there are more."""


def line_key(line: RsiLine, tick: int, place: Callable[[float], int]) -> tuple[Any, ...]:
    """IPOCs by their order and distance, times by their age, places in steps from the setpoint, as `place` tells."""
    driver, session, krc = line.driver, line.driver.session, line.krc
    last, run = session.last, session._run
    newest = None if run is None else run.newest
    own = [one for one in (line.sent, line.overtaken) if one is not None]
    read = [one for one in (last, newest) if one is not None]
    ipocs = [krc.ipoc, *(one.ipoc for one in own), *(one.ipoc for one in read)]
    if line.clock is not None:
        ipocs.append(line.clock)
    ipoc = ranks(ipocs, _IPOCS_APART * IPOC_STEP)
    delays = [krc.delay, *(one.delay for one in own), *(one.delay or 0 for one in read)]
    delay = ranks(delays, _DELAYS_APART)

    def age(time_s: float) -> int:
        cycles = round(2 * (tick * CYCLE_S - time_s) / CYCLE_S)
        return min(cycles, 2 * _TICKS_APART)

    def of_own(one: Own | None) -> tuple[int, ...] | None:
        return (
            None if one is None else (ipoc[one.ipoc], place(one.q), place(one.programmed), delay[one.delay])
        )

    def of_read(one: KrcTelegram | None) -> tuple[int, ...] | None:
        if one is None or one.q is None or one.q_programmed is None:
            return None
        return (ipoc[one.ipoc], place(one.q[0]), place(one.q_programmed[0]), delay[one.delay or 0])

    def of_array(value: Array | None) -> int | None:
        return None if value is None else place(float(value[0]))

    zero = place(0.0)
    sent, origin = driver._sent, driver._origin
    return (
        line.attacks_left,
        (ipoc[krc.ipoc], place(krc.programmed), place(krc.stands), krc.answered, delay[krc.delay]),
        min(tick - line.heard, _TICKS_APART),
        tuple(place(step) - zero for step in line.pending),
        of_own(line.sent) if line.attacks_left else None,
        of_own(line.overtaken),
        line.silent,
        None if line.clock is None else (ipoc[line.clock], line.poses_at, line.posed),
        (session.belief, session.step, of_read(last), age(session._time_s)),
        None if run is None else (run.count, run.step, age(run.first_s), of_read(newest)),
        tuple((of_array(earlier), of_array(earlier + there)) for earlier, there in driver._earlier),
        (
            of_array(origin),
            None if origin is None or sent is None else of_array(origin + sent),
            driver._opened,
        ),
        (line.peer.address, age(line.peer._heard_s)),
    )
