"""The exporter's shell: one connection to the HLI, and a web server that Prometheus reads.

The status is asked for when somebody reads, and no oftener. The HLI may come, go and come back meanwhile.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Histogram, start_http_server
from prometheus_client.core import Metric
from prometheus_client.registry import Collector

from deltaq_protocol.client import Cell, connect
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.messages import Status
from deltaq_services.metrics.families import Delays, families

_log = logging.getLogger(__name__)

DEFAULT_PORT = 9464
"""What exporters without a port of their own use."""

_RETRY_S = 1.0
_ANSWER_S = 3.0
_BUCKETS_S = (0.001, 0.002, 0.004, 0.006, 0.008, 0.01, 0.012, 0.016, 0.02, 0.024, 0.036, 0.05, 0.1, 0.25, 1.0)


class Exporter(Collector):
    """Serves the metrics of the cell whose HLI listens at an address.

    Args:
        hli: where its HLI listens, e.g. `tcp/127.0.0.1:7447`.
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
        """Nothing: what there will be is known when the cell answers."""
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
