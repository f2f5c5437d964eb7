"""Measures a KRC's cycle, by its IPOC and by the clock, and compares it with the cell's.

A KRC that ticks three times as fast moves its robot three times as fast with the same increments. Evidence is judged
as follows:

| by the IPOC | by the clock | what it is |
| --- | --- | --- |
| faster than the cell | any | another cycle |
| any | faster than the cell, for longer than a pause is made up for | another cycle |
| slower | slower | another cycle |
| the cell's, or a count | slower | a busy machine, which no robot is held for |
| slower | the cell's | another kind of count |

An IPOC that grows by 1, or as `driver.ipoc_step` says, is a count and says nothing of time. Any other grows by the
cycle in ms.
"""

import math
from dataclasses import dataclass

from deltaq_services.containment import Part

WINDOW_TICKS = 25
"""Cycles over which the time is taken."""

PACE = 0.8
"""Fraction of the cell's cycle below which a cycle is another one; a slower one is from its inverse on."""

SLOW_WINDOWS = 8
"""Windows in a row that have to be slow by IPOC and clock: of a machine that reads every third telegram, IPOC and clock
agree as well for a moment."""

DRIFT = 0.01
"""Fraction by which a KRC's clock may be faster than this machine's."""

_PAUSE = 1.5
"""Times the silence that telegrams may make up for: one that falls silent for longer is another session's."""


@dataclass
class _Seen(Part):
    """What a `CycleMeter` remembers of a session; times on a monotonic clock [s].

    Attributes:
        step: of the IPOC; 0 before the first session.
        last_s: when the last telegram came.
        ahead_s: how far the KRC's own time has got ahead of the clock since `ahead_from_s`.
        ahead_ticks: its cycles since then.
        too_fast: it got further ahead than a pause explains.
        window_from_s, window_ticks: when the window began, and its cycles.
        slow_windows: in a row.
        tick_s: cycle by the clock in the last window; None before the first.
        seen: a window was as long as the cell says.
    """

    step: int = 0
    last_s: float = 0.0
    ahead_s: float = 0.0
    ahead_from_s: float = 0.0
    ahead_ticks: int = 0
    too_fast: bool = False
    window_from_s: float = 0.0
    window_ticks: int = 0
    slow_windows: int = 0
    tick_s: float | None = None
    seen: bool = False


class CycleMeter(Part):
    """Measures the cycle of one KRC.

    Args:
        cycle_s: the cell's.
        silence_s: after which a KRC counts as silent.
        ipoc_step: by how much the cell says that the IPOC grows; None if it does not say.

    Attributes:
        known: whether the cycle was seen to be the cell's, so that the robot may be driven.
        fault: why it is not the cell's, with both figures and the remedy; empty if nothing speaks against it.
    """

    def __init__(self, cycle_s: float, silence_s: float, ipoc_step: int | None) -> None:
        self.known, self.fault = False, ""
        self._cycle_s, self._given_step = cycle_s, ipoc_step
        self._least_tick_s = (1.0 - DRIFT) * cycle_s
        self._most_ahead_s = _PAUSE * silence_s
        self._seen = _Seen()

    @property
    def detail(self) -> str:
        """The last measured cycle, as text; empty before the first, and if `fault` says it."""
        tick_s = self._seen.tick_s
        if self.fault or tick_s is None:
            return ""
        busy = (
            "" if tick_s < self._cycle_s / PACE else f", the cell says {_ms(self._cycle_s)}: a busy machine?"
        )
        return f"a telegram every {_ms(tick_s)}{busy}"

    def begin(self, step: int, time_s: float) -> None:
        """A session begins.

        Args:
            step: by how much its IPOC grows.
            time_s: when its telegram came, on a monotonic clock.
        """
        self._seen = _Seen(step, last_s=time_s, ahead_from_s=time_s, window_from_s=time_s)
        self._conclude()

    def tick(self, ticks: int, time_s: float) -> None:
        """A telegram of the session.

        Args:
            ticks: cycles since the last one, by its IPOC.
            time_s: when it came.
        """
        own = self._seen
        own.ahead_s += ticks * self._least_tick_s - (time_s - own.last_s)
        own.ahead_ticks += ticks
        own.last_s = time_s
        if own.ahead_s <= 0.0:
            own.ahead_s, own.ahead_from_s, own.ahead_ticks = 0.0, time_s, 0
            if own.too_fast:
                own.too_fast = False
                self._conclude()
        elif own.ahead_s > self._most_ahead_s:
            own.ahead_s = self._most_ahead_s
            if not own.too_fast:
                own.too_fast, own.tick_s = True, (time_s - own.ahead_from_s) / own.ahead_ticks
                self._conclude()
        own.window_ticks += ticks
        if own.window_ticks >= WINDOW_TICKS:
            self._close_window(own, time_s)

    @property
    def _by_ipoc_s(self) -> float | None:
        """Cycle by the IPOC [s]; None if it counts, or is not known."""
        step = self._seen.step
        return None if step <= 1 or self._given_step is not None else step * 1e-3

    def _close_window(self, own: _Seen, time_s: float) -> None:
        own.tick_s = (time_s - own.window_from_s) / own.window_ticks
        own.window_from_s, own.window_ticks = time_s, 0
        by_ipoc_s = self._by_ipoc_s
        is_slow = (
            by_ipoc_s is not None
            and by_ipoc_s > self._cycle_s / PACE
            and own.tick_s > math.sqrt(by_ipoc_s * self._cycle_s)
        )
        own.slow_windows = min(own.slow_windows + 1, SLOW_WINDOWS) if is_slow else 0
        own.seen = own.seen or (own.tick_s >= PACE * self._cycle_s and not is_slow)
        self._conclude()

    def _conclude(self) -> None:
        by_ipoc_s, own = self._by_ipoc_s, self._seen
        another = (
            own.too_fast
            or (by_ipoc_s is not None and by_ipoc_s < PACE * self._cycle_s)
            or own.slow_windows >= SLOW_WINDOWS
        )
        self.fault = self._told(by_ipoc_s, own) if another else ""
        self.known = own.seen and not another

    def _told(self, by_ipoc_s: float | None, own: _Seen) -> str:
        figures = [
            *([] if by_ipoc_s is None else [f"{_ms(by_ipoc_s)} by its IPOC"]),
            *([] if own.tick_s is None else [f"{_ms(own.tick_s)} by the clock"]),
        ]
        count = (
            "" if by_ipoc_s is None else f"; if its IPOC counts otherwise, set driver.ipoc_step to {own.step}"
        )
        return (
            f"the KRC ticks every {' and '.join(figures)}, the cell says {_ms(self._cycle_s)}: start RSI with the "
            f"cell's cycle (RSI_ON with #IPO_FAST is 4 ms, with #IPO 12 ms), or correct cycle_s{count}"
        )


def _ms(seconds: float) -> str:
    return f"{seconds * 1e3:.1f} ms"
