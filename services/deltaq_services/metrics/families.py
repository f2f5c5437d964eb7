"""A cell's status as families of metrics; plain, without clock or sockets.

What an alarm or a plot asks for has a family of its own. Every counter of every service is in `deltaq_counter_total`
as well, under the name that the reference explains. No label is ever text that a client chose: whoever may name itself
could make series without end.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from deltaq_protocol.audit import AuditKind
from deltaq_protocol.messages import Phase, RobotStatus, Status
from deltaq_services.counters import HLI, ROBOT_SERVER, SIM

# How long after a robot's state its verdict came, where both are heard.

_KEPT = 64
"""Cycles whose verdicts may still come."""


class Delays:
    """Of one robot; the shell passes the time in."""

    def __init__(self) -> None:
        self._came: OrderedDict[int, float] = OrderedDict()
        self._last_s: float | None = None

    def state(self, cycle: int, time_s: float) -> float | None:
        """A state has come; returns the time since the one before it [s], None for the first."""
        interval_s = None if self._last_s is None else time_s - self._last_s
        self._last_s = self._came[cycle] = time_s
        if len(self._came) > _KEPT:
            self._came.popitem(last=False)
        return interval_s

    def verdict(self, cycle: int, time_s: float) -> float | None:
        """A verdict on that cycle has come; returns how long after its state [s], None if that was not heard."""
        came_s = self._came.get(cycle)
        return None if came_s is None else time_s - came_s


_Labels = tuple[str, ...]
_Sample = tuple[_Labels, float]


def families(status: Status | None) -> Iterator[Metric]:
    """Families of a status.

    Args:
        status: status of the cell; None if no answer came, which the metrics show too.
    """
    yield _gauge("deltaq_up", "1 if the HLI answered", (), [((), float(status is not None))])
    if status is None:
        return
    yield _gauge("deltaq_cell_info", "The running cell", ("cell", "identity"), [(_cell(status), 1.0)])
    yield from _of_robots(status.robots)
    yield from _of_cell(status)
    yield _counter("deltaq_counter", "Counts, see the reference", ("service", "robot", "name"), _all(status))


def _of_robots(robots: Mapping[str, RobotStatus]) -> Iterator[Metric]:
    counters = {name: robot.counters for name, robot in robots.items()}
    yield _counter(
        "deltaq_cycles",
        "Cycles of the robot's session",
        ("robot",),
        [((name,), robot.cycle) for name, robot in robots.items()],
    )
    for family, counter, help_ in (
        ("deltaq_admissions", "admissions", "Cycles with a fresh admission"),
        ("deltaq_replies_missed", "reply_missed", "Cycles whose reply the KRC did not take"),
    ):
        yield _counter(
            family,
            help_,
            ("robot",),
            [((name,), counted.get(counter, 0)) for name, counted in counters.items()],
        )
    for family, prefix, label, help_ in (
        ("deltaq_admissions_not_taken", "admission_", "reason", "Admissions that were not taken"),
        ("deltaq_braked_cycles", "braked_cycles_", "cause", "Cycles of the brake"),
        ("deltaq_held", "held_", "reason", "Times that the robot was held"),
    ):
        yield _counter(
            family,
            help_,
            ("robot", label),
            [
                ((name, end), count)
                for name, counted in counters.items()
                for end, count in _endings(counted, prefix)
            ],
        )
    yield _gauge(
        "deltaq_phase",
        "1 for the phase that the robot is in",
        ("robot", "phase"),
        [
            ((name, phase.value), float(robot.phase is phase))
            for name, robot in robots.items()
            for phase in Phase
        ],
    )
    yield _gauge(
        "deltaq_leased",
        "1 if a client holds the robot's lease",
        ("robot",),
        [((name,), float(robot.lease.holder is not None)) for name, robot in robots.items()],
    )
    yield _gauge(
        "deltaq_drive_lag_seconds",
        "Measured lag of an axis, counted from 1, until a setpoint has arrived",
        ("robot", "axis"),
        [
            ((name, str(axis)), lag_s)
            for name, robot in robots.items()
            for axis, lag_s in enumerate(robot.lag_s, start=1)
            if lag_s is not None
        ],
    )
    yield _gauge(
        "deltaq_state_age_seconds",
        "Age of the newest state at the HLI",
        ("robot",),
        [((name,), robot.state_age_s) for name, robot in robots.items() if robot.state_age_s is not None],
    )


def _of_cell(status: Status) -> Iterator[Metric]:
    for family, counted, prefix, label, help_ in (
        ("deltaq_verdicts", status.hli, "verdicts_", "outcome", "Verdicts of the gate"),
        ("deltaq_refusals", status.hli, "refused_", "reason", "Increments that never reached the gate"),
        ("deltaq_gate_reasons", status.gate, "reason_", "reason", "Verdicts by their first reason"),
        ("deltaq_missed_admissions", status.gate, "missed_admissions_", "robot", "Admissions not taken"),
    ):
        yield _counter(family, help_, (label,), [((end,), n) for end, n in _endings(counted, prefix)])
    yield _counter(
        "deltaq_attempts_refused",
        "Attempts of clients that were refused",
        ("what", "reason"),
        [
            ((kind.value, code), n)
            for kind in AuditKind
            for code, n in _endings(status.hli, f"attempts_refused_{kind}_")
        ],
    )
    yield _counter(
        "deltaq_guarded_refused",
        "Messages of the guarded realm that were not believed",
        ("service", "robot", "cause"),
        [
            ((service, robot, cause), sum(n for _, n in refused))
            for service, robot, counted in _counted(status)
            for cause in ("forged", "unbound")
            if (refused := _endings(counted, f"{cause}_"))
        ],
    )
    connections, sessions = (
        status.hli.get(name, 0) for name in ("tcp_connections_open", "zenoh_sessions_open")
    )
    clearance_m = None if status.nearest is None else status.nearest.distance_m
    for family, value, help_ in (
        ("deltaq_gate_age_seconds", status.gate_age_s, "Age of the gate's newest heartbeat at the HLI"),
        ("deltaq_clearance_metres", clearance_m, "Distance of the nearest pair"),
        ("deltaq_contacts_allowed", len(status.contacts), "Contacts that are allowed now"),
        (
            "deltaq_lagging_streams",
            len(status.lagging),
            "Streams that are silent, or slower than they should be",
        ),
        ("deltaq_cell_mismatches", len(status.mismatches), "Services that have read another cell"),
        ("deltaq_tcp_connections", connections, "TCP connections that are open now"),
        ("deltaq_zenoh_sessions", sessions, "zenoh sessions of clients that are open now"),
    ):
        if value is not None:
            yield _gauge(family, help_, (), [((), value)])


def _all(status: Status) -> list[_Sample]:
    return [
        ((service, robot, name), n)
        for service, robot, counted in _counted(status)
        for name, n in counted.items()
    ]


def _counted(status: Status) -> list[tuple[str, str, Mapping[str, int]]]:
    """What each service counts: its name, its robot if it has one, and its counters."""
    services: list[tuple[str, str, Mapping[str, int]]] = [(HLI, "", status.hli), (SIM, "", status.gate)]
    return services + [(ROBOT_SERVER, name, robot.counters) for name, robot in status.robots.items()]


def _cell(status: Status) -> _Labels:
    return status.cell, status.identity


def _endings(counters: Mapping[str, int], prefix: str) -> list[tuple[str, int]]:
    """Counters whose name begins so, each by the rest of it."""
    return [(name.removeprefix(prefix), n) for name, n in counters.items() if name.startswith(prefix)]


def _gauge(name: str, help_: str, labels: _Labels, samples: Iterable[_Sample]) -> Metric:
    return _filled(GaugeMetricFamily(name, help_, labels=labels), samples)


def _counter(name: str, help_: str, labels: _Labels, samples: Iterable[_Sample]) -> Metric:
    return _filled(CounterMetricFamily(name, help_, labels=labels), samples)


def _filled(family: GaugeMetricFamily | CounterMetricFamily, samples: Iterable[_Sample]) -> Metric:
    for labels, value in samples:
        family.add_metric(labels, value)
    return family
