"""Verbs that follow the streams of a running cell."""

from __future__ import annotations

import difflib
import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.console import print_json, print_table
from deltaq_deploy.command.options import CellOption, JsonOption, UrlOption
from deltaq_protocol.errors import DeltaqError

if TYPE_CHECKING:
    from deltaq_deploy.launch.cell_connection import Listener
    from deltaq_protocol.messages import Description
    from deltaq_protocol.topic import Topic


def by_name(name: str) -> Topic:
    """The row of that name.

    Raises:
        DeltaqError: naming those that there are.
    """
    from deltaq_protocol.topics import TOPICS

    for topic in TOPICS:
        if topic.name == name:
            return topic
    names = [topic.name for topic in TOPICS]
    near = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    raise DeltaqError(f"no topic {name!r}; {hint}the topics are {', '.join(names)}")


def open_streams() -> tuple[Topic, ...]:
    """The streams that a client can watch: those of the open realm that the table of topics permits."""
    from deltaq_protocol.topic import Kind, Party, Realm
    from deltaq_protocol.topics import TOPICS

    return tuple(
        topic
        for topic in TOPICS
        if (topic.realm, topic.kind) == (Realm.OPEN, Kind.STREAM) and Party.CLIENT in topic.readers
    )


def open_stream(name: str) -> Topic:
    """The row of that name, if it can be watched.

    Raises:
        DeltaqError: if there is none, or it is a query, or belongs to the guarded realm.
    """
    from deltaq_protocol.topic import Kind, Realm

    topic = by_name(name)
    if topic not in open_streams():
        why = (
            "is in the guarded realm, which no client reaches"
            if topic.realm is Realm.GUARDED
            else "is a query"
            if topic.kind is Kind.QUERY
            else f"is read by the {' and the '.join(topic.readers)} alone"
        )
        names = ", ".join(row.name for row in open_streams())
        raise DeltaqError(f"topic {name!r} {why}; those that can be watched are {names}")
    return topic


def echo(
    topic: Annotated[str, typer.Argument(help="state, verdict or proximity.")],
    cell: CellOption = "lab",
    url: UrlOption = None,
    robot: Annotated[str, typer.Option(help="Only this robot.")] = "",
    count: Annotated[int, typer.Option(min=0, help="End after this many messages; 0: never.")] = 0,
) -> None:
    """Print messages as they come, one JSON object a line."""
    import zenoh

    from deltaq_deploy.launch.cell_connection import Where, describe, listen
    from deltaq_protocol.codec import unpack

    row = open_stream(topic)
    where = Where.of(cell, url, robot)
    describe(where, "deltaq topic echo")  # or say why there is nothing to hear
    printed = 0
    channel: Any = zenoh.handlers.FifoChannel(1024)
    with listen(where) as listener, listener.subscribe(row, channel, robot) as samples:
        try:
            for sample in samples:
                print_json(unpack(row.message, sample.payload.to_bytes()).model_dump(mode="json"))
                printed += 1
                if printed == count:
                    return
        except KeyboardInterrupt:
            return


def hz(
    cell: CellOption = "lab",
    url: UrlOption = None,
    duration_s: Annotated[float, typer.Option(min=0.1, help="How long to listen.")] = 5.0,
    json: JsonOption = False,
) -> None:
    """Measure rate and regularity of each stream of a running cell."""
    from deltaq_deploy.launch.cell_connection import Where, describe, listen
    from deltaq_deploy.launch.rates import rate_of
    from deltaq_services.rate_limit import lags

    where = Where.of(cell, url)
    description = describe(where, "deltaq topic hz")
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
        f"{description.cell}: cycle {description.cycle_s * 1000:g} ms, measured for {duration_s:g} s",
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
