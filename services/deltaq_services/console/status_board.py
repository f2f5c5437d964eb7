"""The status that browsers get when it changes: the cell's, with stop and recording, and the log's lines."""

from collections import deque
from collections.abc import Collection, Iterable, Mapping
from datetime import UTC, datetime
from typing import Literal

from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.console.client import Client
from deltaq_services.console.commands import Record
from deltaq_services.console.feed import RobotMotion
from deltaq_services.console.messages import ConsoleEvent, ConsoleStatus, RecordingView, StopPhase
from deltaq_services.console.outputs import ConsoleOutput, ToClient, ToRecorder
from deltaq_services.console.robot_side import RobotSide

KEPT = 200
"""Number of newest lines that a new client gets."""
QUIET_S = 2.0
"""A line that repeats within this time is counted, and sent with its count at the end."""

STATUS_S = 1.0
"""A status that has not changed is sent again after this."""
ENDING = ".mcap"

EventKind = Literal["verdict", "lease", "stop", "phase", "link", "client", "recording", "view"]


class EventLog:
    """Lines of the log; each reader gets the lines that are new."""

    def __init__(self) -> None:
        self._kept: deque[ConsoleEvent] = deque(maxlen=KEPT)
        self._new: list[ConsoleEvent] = []
        self._quiet: dict[tuple[EventKind, str, str], tuple[float, int, ConsoleEvent]] = {}

    def add(self, now_s: float, kind: EventKind, text: str, robot: str = "") -> None:
        """Add a line; it is sent at once."""
        self._tell(ConsoleEvent(time_s=now_s, kind=kind, robot=robot, text=text))

    def repeat(self, now_s: float, kind: EventKind, group: str, text: str, robot: str = "") -> None:
        """Add a line that may come every cycle; repeated lines of a group count as one."""
        key = (kind, robot, group)
        event = ConsoleEvent(time_s=now_s, kind=kind, robot=robot, text=text)
        if key in self._quiet:
            until_s, count, _ = self._quiet[key]
            self._quiet[key] = (until_s, count + 1, event)
        else:
            self._quiet[key] = (now_s + QUIET_S, 0, event)
            self._tell(event)

    def news(self, now_s: float) -> list[ConsoleEvent]:
        """Lines since this was asked last."""
        for key, (until_s, count, event) in list(self._quiet.items()):
            if now_s < until_s:
                continue
            if count:
                self._tell(event.model_copy(update={"count": count}))
                self._quiet[key] = (now_s + QUIET_S, 0, event)
            else:
                del self._quiet[key]
        new, self._new = self._new, []
        self._kept.extend(new)
        return new

    @property
    def kept(self) -> Iterable[ConsoleEvent]:
        """The newest lines that were asked for, oldest first."""
        return tuple(self._kept)

    def _tell(self, event: ConsoleEvent) -> None:
        self._new.append(event)


class StopProgress:
    """The newest stop of any sender.

    Attributes:
        phase: its progress.
        by: name of the client that asked; None for a client outside this console.
    """

    def __init__(self) -> None:
        self.phase = StopPhase.NONE
        self.by: str | None = None
        self._seen_held = False

    def ask(self, name: str) -> None:
        """A client asks for a stop."""
        self.by = name
        self.phase = StopPhase.ASKED
        self._seen_held = False

    def latched(self) -> None:
        """Note the HLI's reply that every robot is held."""
        if self.phase is StopPhase.ASKED:
            self.phase = StopPhase.STOPPING

    def see(self, robots: Mapping[str, RobotMotion]) -> None:
        """Take the robots' newest states."""
        held = all(motion.phase in (Phase.HELD, Phase.OFFLINE) for motion in robots.values())
        stopped = any(_is_stopped(motion) for motion in robots.values())
        at_rest = all(motion.is_still or motion.phase is Phase.OFFLINE for motion in robots.values())
        if self.phase in (StopPhase.NONE, StopPhase.ASKED):
            if held and (stopped or (at_rest and self.phase is StopPhase.ASKED)):
                self.phase, self._seen_held = StopPhase.STOPPING, True
        elif held:
            self._seen_held = True
            self.phase = StopPhase.AT_REST if at_rest else StopPhase.STOPPING
        elif self._seen_held and not any(motion.phase is None for motion in robots.values()):
            # a robot was reset. The HLI's reply may come before the states that it refers to, and silent robots have
            # no new state
            self.phase, self.by = StopPhase.NONE, None


def _is_stopped(motion: RobotMotion) -> bool:
    return motion.phase is Phase.HELD and motion.reason is ReasonCode.OPERATOR_STOP


class RecordingDesk:
    """The present recording, and the result of the last one.

    Args:
        cell: name of the cell.
        has_folder: whether the console was given a folder for recordings.
    """

    def __init__(self, cell: str, has_folder: bool) -> None:
        self._cell, self._has_folder = cell, has_folder
        self._view = RecordingView()

    @property
    def view(self) -> RecordingView | None:
        """The status for browsers; None without a folder."""
        return self._view if self._has_folder else None

    def handle(self, command: Record, now_s: float) -> ToRecorder:
        """Begin or end a recording, or raise `ValueError` with the reason why not."""
        if not self._has_folder:
            raise ValueError(
                "the console was given no folder for recordings; start it with --recordings FOLDER"
            )
        if command.action == "stop":
            if not self._view.file:
                raise ValueError("action: nothing is being recorded")
            return ToRecorder(None)
        if self._view.file:
            raise ValueError(f"action: {self._view.file} is being recorded already")
        asked = datetime.fromtimestamp(now_s, UTC)
        self._view = RecordingView(file=f"{self._cell}-{asked:%Y%m%d-%H%M%S}{ENDING}")
        return ToRecorder(self._view.file)

    def began(self, now_s: float) -> None:
        """The recorder writes."""
        if self._view.file:
            self._view = RecordingView(file=self._view.file, since_s=now_s)

    def ended(self, why: str) -> str:
        """Note that the recorder has ended, as asked or by an error; returns a line for the log."""
        text = f"{self._view.file} was recorded" if not why else f"{self._view.file}: {why}"
        self._view = RecordingView(text=text)
        return text


class StatusBoard:
    """The status of one cell, and the part of it that was sent to each browser.

    Args:
        robots: each robot's side.
        desk: the recording that is being written.
        log: the event log, whose lines are sent too.
        cell: its name or file, as commands take it.

    Attributes:
        hli: whether the HLI answers.
        text: why it does not.
    """

    def __init__(
        self, robots: Mapping[str, RobotSide], desk: RecordingDesk, log: EventLog, cell: str
    ) -> None:
        self.hli, self.text = False, "the HLI has not answered yet"
        self._remedy = (
            f"No robot can be driven, and control is lost. Start it: deltaq up --cell {cell} --only hli"
        )
        self._robots, self._desk, self._log = robots, desk, log
        self._told: dict[int, tuple[float, ConsoleStatus]] = {}

    def heard(self, holders: Mapping[str, str | None], now_s: float) -> None:
        """Take the holders of all leases from the HLI."""
        if not self.hli:
            self._log.add(now_s, "link", "the HLI answers")
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
            side.outside_holder = None  # its last message is old

    def forget(self, client: Client) -> None:
        """Forget a disconnected browser."""
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
