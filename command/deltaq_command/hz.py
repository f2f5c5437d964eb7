"""`deltaq hz`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_command.options import CellOption, JsonOption, UrlOption

if TYPE_CHECKING:
    from deltaq_launch.cell_connection import Listener
    from deltaq_protocol.messages import Description
    from deltaq_protocol.topic import Topic


def hz(
    cell: CellOption = "lab",
    url: UrlOption = None,
    duration_s: Annotated[float, typer.Option(min=0.1, help="How long to listen.")] = 5.0,
    json: JsonOption = False,
) -> None:
    """Measure rate and regularity of each stream of a running cell."""
    from dataclasses import asdict

    from deltaq_command.console import print_json, print_table
    from deltaq_launch.cell_connection import Where, describe, listen
    from deltaq_launch.rates import rate_of
    from deltaq_services.lagging import lags

    where = Where.of(cell, url)
    description = describe(where, "deltaq hz")
    with listen(where) as listener:
        arrivals = _listen(listener, description, duration_s)
    rates = {key: rate_of(times) for key, (_, times) in sorted(arrivals.items())}
    expected = {key: row.steady_hz(description.cycle_s) for key, (row, _) in arrivals.items()}
    lagging = {key: lags(row, description.cycle_s, rates[key].rate_hz) for key, (row, _) in arrivals.items()}
    if json:
        print_json(
            {
                "cell": description.cell,
                "cycle_s": description.cycle_s,
                "topics": {
                    key: asdict(rate) | {"expected_hz": expected[key], "lagging": lagging[key]}
                    for key, rate in rates.items()
                },
            }
        )
        return
    print_table(
        f"{description.cell}: cycle {description.cycle_s * 1000:g} ms, heard for {duration_s:g} s",
        ("key", "messages", "Hz", "expected", "median ms", "p99 ms", "longest ms"),
        (
            (
                key,
                rate.count,
                _number(rate.rate_hz),
                f"{_number(expected[key]) or 'any'}{', lagging' if lagging[key] else ''}",
                *(_ms(value) for value in _periods(rate)),
            )
            for key, rate in rates.items()
        ),
    )


def _listen(
    listener: Listener, description: Description, duration_s: float
) -> dict[str, tuple[Topic, list[float]]]:
    """When messages came, by key; a stream that has to come and does not is there too."""
    import time

    from deltaq_command.topics import open_streams

    arrivals: dict[str, tuple[Topic, list[float]]] = {}

    def take(sample: Any, row: Topic) -> None:
        arrivals.setdefault(str(sample.key_expr), (row, []))[1].append(time.monotonic())

    for row in open_streams():
        if row.steady_hz(description.cycle_s) is not None:
            arrivals |= {row.key(description.cell, robot=robot): (row, []) for robot in description.robots}
    subscribers = [
        listener.subscribe(row, lambda sample, row=row: take(sample, row)) for row in open_streams()
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
