"""`deltaq hz`."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.cli.options import CellOption, JsonOption, UrlOption

if TYPE_CHECKING:
    from deltaq_deploy.running import Listener


def hz(
    cell: CellOption = "lab",
    url: UrlOption = None,
    duration_s: Annotated[float, typer.Option(min=0.1, help="How long to listen.")] = 5.0,
    json: JsonOption = False,
) -> None:
    """Measure rate and regularity of each stream of a running cell."""
    from dataclasses import asdict

    from deltaq_deploy.cli.console import print_json, print_table
    from deltaq_deploy.rates import rate_of
    from deltaq_deploy.running import Where, describe, listen

    where = Where.of(cell, url)
    description = describe(where, "deltaq hz")
    with listen(where) as listener:
        arrivals = _listen(listener, duration_s)
    rates = {key: rate_of(times) for key, times in sorted(arrivals.items())}
    if json:
        print_json(
            {
                "cell": description.cell,
                "cycle_s": description.cycle_s,
                "topics": {key: asdict(rate) for key, rate in rates.items()},
            }
        )
        return
    print_table(
        f"{description.cell}: cycle {description.cycle_s * 1000:g} ms, heard for {duration_s:g} s",
        ("key", "messages", "Hz", "median ms", "p99 ms", "longest ms"),
        (
            (key, rate.count, _number(rate.rate_hz), *(_ms(value) for value in _periods(rate)))
            for key, rate in rates.items()
        ),
    )


def _listen(listener: Listener, duration_s: float) -> dict[str, list[float]]:
    import time

    from deltaq_deploy.cli.topics import open_streams

    arrivals: dict[str, list[float]] = defaultdict(list)
    subscribers = [
        listener.subscribe(row, lambda sample: arrivals[str(sample.key_expr)].append(time.monotonic()))
        for row in open_streams()
    ]
    try:
        time.sleep(duration_s)
    except KeyboardInterrupt:
        pass
    finally:
        for subscriber in subscribers:
            subscriber.undeclare()
    return arrivals


def _periods(rate: Any) -> tuple[float | None, float | None, float | None]:
    return rate.period_median_s, rate.period_p99_s, rate.period_max_s


def _number(value: float | None) -> str | None:
    return None if value is None else f"{value:.1f}"


def _ms(value: float | None) -> str | None:
    return None if value is None else f"{value * 1000:.2f}"
