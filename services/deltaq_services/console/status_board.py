"""What browsers are told when it changes: the cell's status, each with its own leases marked, and the log's lines."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from deltaq_services.console.client import Client
from deltaq_services.console.event_log import EventLog
from deltaq_services.console.messages import ConsoleStatus
from deltaq_services.console.outputs import ConsoleOutput, ToClient
from deltaq_services.console.recordings import RecordingDesk
from deltaq_services.console.robot_side import RobotSide
from deltaq_services.console.stop_progress import StopProgress

STATUS_S = 1.0
"""A status that has not changed is sent again after this."""


class StatusBoard:
    """The status of one cell, and the part of it that each browser has got.

    Args:
        robots: each robot's side.
        desk: the recording that is being written.
        log: the event log, whose lines are sent too.
        cell: its name or file, as commands take it.

    Attributes:
        hli: whether the HLI is heard.
        text: why it is not.
    """

    def __init__(
        self, robots: Mapping[str, RobotSide], desk: RecordingDesk, log: EventLog, cell: str
    ) -> None:
        self.hli, self.text = False, "the HLI is not heard yet"
        self._remedy = (
            f"No robot can be driven, and control is lost. Start it: deltaq up --cell {cell} --only hli"
        )
        self._robots, self._desk, self._log = robots, desk, log
        self._told: dict[int, tuple[float, ConsoleStatus]] = {}

    def heard(self, holders: Mapping[str, str | None], now_s: float) -> None:
        """The HLI has reported the holders of all leases."""
        if not self.hli:
            self._log.add(now_s, "link", "the HLI is heard")
        self.hli, self.text = True, ""
        for robot, holder in holders.items():
            if robot in self._robots:
                self._robots[robot].outside_holder = holder

    def silent(self, text: str, now_s: float) -> None:
        """The HLI does not answer."""
        if self.hli:
            self._log.add(now_s, "link", f"the HLI is silent: {text}")
        self.hli, self.text = False, text
        for side in self._robots.values():
            side.outside_holder = None  # what it told last is old

    def forget(self, client: Client) -> None:
        """A browser has gone."""
        self._told.pop(client.number, None)

    def tell(self, clients: Collection[Client], stop: StopProgress, now_s: float) -> list[ConsoleOutput]:
        """The messages to send now."""
        news = self._log.news(now_s)
        views = {name: side.view(now_s) for name, side in self._robots.items()}
        outputs: list[ConsoleOutput] = []
        for client in clients:
            outputs += [ToClient(client.number, event) for event in news]
            status = ConsoleStatus(
                hli=self.hli,
                text=self.text,
                remedy="" if self.hli else self._remedy,
                robots={name: self._robots[name].seen_by(client, view) for name, view in views.items()},
                stop=stop.phase,
                wanted_by=stop.by,
                clients=len(clients),
                recording=self._desk.view,
            )
            told_s, told = self._told.get(client.number, (0.0, None))
            if status != told or now_s - told_s >= STATUS_S:
                self._told[client.number] = (now_s, status)
                outputs.append(ToClient(client.number, status))
        return outputs
