"""A cell's metrics for Prometheus: one connection to the HLI, and a web server that Prometheus reads.

The status is requested once for each scrape. The HLI may stop and come back at any time.
"""

import asyncio
import logging
import time
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry, Histogram, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from deltaq_protocol.audit import AuditKind
from deltaq_protocol.client import Cell, connect
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotStatus, Status
from deltaq_protocol.sayings import HLI, SIM

# Delays between a robot's states and their verdicts.

_KEPT = 64
"""Cycles whose verdicts may still come."""


class Delays:
    """Delays of one robot's messages; the caller passes the times."""

    def __init__(self) -> None:
        self._came: OrderedDict[int, float] = OrderedDict()
        self._last_s: float | None = None

    def state(self, cycle: int, time_s: float) -> float | None:
        """Take a state; returns the time since the one before it [s], None for the first."""
        interval_s = None if self._last_s is None else time_s - self._last_s
        self._last_s = self._came[cycle] = time_s
        if len(self._came) > _KEPT:
            self._came.popitem(last=False)
        return interval_s

    def verdict(self, cycle: int, time_s: float) -> float | None:
        """Take a verdict; returns its delay after the state of its cycle [s], None if that state is unknown."""
        came_s = self._came.get(cycle)
        return None if came_s is None else time_s - came_s


_Labels = tuple[str, ...]
_Sample = tuple[_Labels, float]


def families(status: Status | None) -> Iterator[Metric]:
    """A cell's status as families of metrics.

    Every quantity that an alarm or a plot needs has a family of its own. Every counter of every service is in
    `deltaq_counter_total` as well, under the name that the reference explains. No label is text that a client chose:
    it could create series without end.

    Args:
        status: status of the cell; None if no answer came, which the metrics show too.
    """
    yield _gauge("deltaq_up", "1 if the HLI answered", (), [((), float(status is not None))])
    if status is None:
        return
    info = [((status.cell, status.identity), 1.0)]
    yield _gauge("deltaq_cell_info", "The running cell", ("cell", "identity"), info)
    yield from _of_robots(status.robots)
    yield from _of_cell(status)
    counts = [
        ((service, robot, name), n)
        for service, robot, counted in _counted(status)
        for name, n in counted.items()
    ]
    yield _counter("deltaq_counter", "Counts, see the reference", ("service", "robot", "name"), counts)


def _of_robots(robots: Mapping[str, RobotStatus]) -> Iterator[Metric]:
    for family, counter, help_ in (
        ("deltaq_admissions", "admissions", "Cycles with a fresh admission"),
        ("deltaq_replies_missed", "reply_missed", "Cycles whose reply the KRC did not take"),
    ):
        counted = [((name,), robot.counters.get(counter, 0)) for name, robot in robots.items()]
        yield _counter(family, help_, ("robot",), counted)
    for family, prefix, label, help_ in (
        ("deltaq_admissions_not_taken", "admission_", "reason", "Admissions that were not taken"),
        ("deltaq_braked_cycles", "braked_cycles_", "cause", "Cycles of the brake"),
        ("deltaq_held", "held_", "reason", "Times that the robot was held"),
    ):
        ends = [
            ((name, end), count)
            for name, robot in robots.items()
            for end, count in _endings(robot.counters, prefix)
        ]
        yield _counter(family, help_, ("robot", label), ends)
    cycles = [((name,), robot.cycle) for name, robot in robots.items()]
    yield _counter("deltaq_cycles", "Cycles of the robot's session", ("robot",), cycles)
    phases = [
        ((name, phase.value), float(robot.phase is phase))
        for name, robot in robots.items()
        for phase in Phase
    ]
    yield _gauge("deltaq_phase", "1 for the phase that the robot is in", ("robot", "phase"), phases)
    leased = [((name,), float(robot.lease.holder is not None)) for name, robot in robots.items()]
    yield _gauge("deltaq_leased", "1 if a client holds the robot's lease", ("robot",), leased)
    lags = [
        ((name, str(axis)), lag_s)
        for name, robot in robots.items()
        for axis, lag_s in enumerate(robot.lag_s, start=1)
        if lag_s is not None
    ]
    what = "Measured lag of an axis, counted from 1, until a setpoint has arrived"
    yield _gauge("deltaq_drive_lag_seconds", what, ("robot", "axis"), lags)
    ages = [((name,), robot.state_age_s) for name, robot in robots.items() if robot.state_age_s is not None]
    yield _gauge("deltaq_state_age_seconds", "Age of the newest state at the HLI", ("robot",), ages)


def _of_cell(status: Status) -> Iterator[Metric]:
    for family, counted, prefix, label, help_ in (
        ("deltaq_verdicts", status.hli, "verdicts_", "outcome", "Verdicts of the gate"),
        ("deltaq_refusals", status.hli, "refused_", "reason", "Increments that never reached the gate"),
        ("deltaq_gate_reasons", status.gate, "reason_", "reason", "Verdicts by their first reason"),
        ("deltaq_missed_admissions", status.gate, "missed_admissions_", "robot", "Admissions not taken"),
    ):
        yield _counter(family, help_, (label,), [((end,), n) for end, n in _endings(counted, prefix)])
    refused = [
        ((kind.value, code), n)
        for kind in AuditKind
        for code, n in _endings(status.hli, f"attempts_refused_{kind}_")
    ]
    what = "Attempts of clients that were refused"
    yield _counter("deltaq_attempts_refused", what, ("what", "reason"), refused)
    stale = [
        ((service, robot, "stale"), sum(n for _, n in endings))
        for service, robot, counted in _counted(status)
        if (endings := _endings(counted, "stale_"))
    ]
    what = "Messages of the guarded realm that were not believed"
    yield _counter("deltaq_guarded_refused", what, ("service", "robot", "cause"), stale)
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


def _counted(status: Status) -> list[tuple[str, str, Mapping[str, int]]]:
    """What each service counts: its name, its robot if it has one, and its counters."""
    services: list[tuple[str, str, Mapping[str, int]]] = [(HLI, "", status.hli), (SIM, "", status.gate)]
    return services + [("robot_server", name, robot.counters) for name, robot in status.robots.items()]


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


_log = logging.getLogger(__name__)

DEFAULT_PORT = 9464
"""What exporters without a port of their own use."""

_RETRY_S = 1.0
_ANSWER_S = 3.0
_BUCKETS_S = (0.001, 0.002, 0.004, 0.006, 0.008, 0.01, 0.012, 0.016, 0.02, 0.024, 0.036, 0.05, 0.1, 0.25, 1.0)


class Exporter(Collector):
    """Serves the metrics of the cell whose HLI listens at an address.

    Args:
        hli: address of its HLI, e.g. `tcp/127.0.0.1:7447`.
    """

    def __init__(self, hli: str) -> None:
        self.registry = CollectorRegistry()
        self._hli = hli
        self._cell: Cell | None = None
        self._interval_s = self._histogram("deltaq_state_interval_seconds", "Time between two states")
        self._delay_s = self._histogram(
            "deltaq_verdict_delay_seconds", "Time from a state to the verdict of its cycle"
        )
        self.registry.register(self)

    def collect(self) -> Iterator[Metric]:
        """Families of the status as it is now; called by the web server's threads."""
        return families(self._status())

    def describe(self) -> Iterator[Metric]:
        """Describe nothing in advance: the families are known when the cell answers."""
        return iter(())

    async def run(self, address: str, port: int) -> None:
        """Serve until cancelled.

        Raises:
            OSError: the port cannot be listened on.
        """
        self._loop = asyncio.get_running_loop()
        server, thread = start_http_server(port, address, self.registry)
        page = f"http://{address}:{server.server_port}/metrics"
        _log.info("ready: metrics of %s at %s", self._hli, page)
        try:
            while True:
                await self._watch()
                await asyncio.sleep(_RETRY_S)
        finally:
            await asyncio.to_thread(server.shutdown)
            server.server_close()
            thread.join()

    async def _watch(self) -> None:
        try:
            async with connect(self._hli, "metrics") as cell:
                self._cell = cell
                async with asyncio.TaskGroup() as tasks:
                    for robot in cell.robots:
                        delays = Delays()
                        tasks.create_task(self._states(cell, robot, delays))
                        tasks.create_task(self._verdicts(cell, robot, delays))
        except* ServiceUnreachableError:
            pass  # `deltaq_up` says so, and it is tried again
        finally:
            self._cell = None

    async def _states(self, cell: Cell, robot: str, delays: Delays) -> None:
        async for state in cell.states(robot):
            interval_s = delays.state(state.cycle, time.monotonic())
            if interval_s is not None:
                self._interval_s.labels(robot).observe(interval_s)

    async def _verdicts(self, cell: Cell, robot: str, delays: Delays) -> None:
        async for verdict in cell.verdicts(robot):
            delay_s = delays.verdict(verdict.cycle, time.monotonic())
            if delay_s is not None:
                self._delay_s.labels(robot).observe(delay_s)

    def _status(self) -> Status | None:
        cell = self._cell
        if cell is None:
            return None
        asked = asyncio.run_coroutine_threadsafe(cell.status(), self._loop)
        try:
            return asked.result(_ANSWER_S)
        except (DeltaqError, TimeoutError):
            asked.cancel()
            return None

    def _histogram(self, name: str, help_: str) -> Histogram:
        return Histogram(
            name, f"{help_}, where this is heard", ("robot",), buckets=_BUCKETS_S, registry=self.registry
        )
