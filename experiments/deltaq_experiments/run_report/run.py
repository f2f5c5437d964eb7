"""A recording read into figures: what each robot did, and what happened when."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from deltaq_cell.cell_model import CellModel
from deltaq_experiments.run_report.robot_run import RobotRun
from deltaq_protocol import topics
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import Command, CommandReply, GateMemory, ServerState
from deltaq_protocol.messages import NearestPair, Phase, Proximity, RobotState, Verdict
from deltaq_services.recorder.reader import Recorded, Recording

READ = (
    topics.STATE,
    topics.VERDICT,
    topics.PROXIMITY,
    topics.SERVER_STATE,
    topics.COMMAND,
    topics.COMMAND_REPLY,
    topics.GATE_MEMORY,
)
_SILENT_CYCLES = 10
"""States that fail to come for so many cycles are an event."""
_SAME_EVENT_S = 1.0
"""The same fault within this time is one event."""


class EmptyRecordingError(DeltaqError):
    """A recording in which no robot has a state."""


class RunEventKind(StrEnum):
    """What an event is about."""

    STOP = "stop"
    HOLD = "hold"
    RESET = "reset"
    FAULT = "fault"
    GAP = "gap"


@dataclass
class RunEvent:
    """Something that an operator would ask about.

    Attributes:
        time_s: from the beginning of the recording [s].
        kind: what it is about.
        robot: its name; empty if it concerns the cell.
        text: for people.
        count: how often it happened in a row.
    """

    time_s: float
    kind: RunEventKind
    robot: str
    text: str
    count: int = 1


@dataclass
class RecordedRun:
    """A recording in figures.

    Attributes:
        path: the file.
        sha256: of its bytes.
        about: cell, cycle, protocol, source and identity, as the file says.
        cell: the model of the cell.
        robots: by name.
        begin_ns: time of the first message [ns].
        length_s: from the first message to the last [s].
        gates: fingerprints of the gates, in the order in which they appeared.
        events: in the order of time.
        nearest: time [s] and distance [m] of the nearest pair of the cell.
        least: the nearest pair of the whole recording and its time [s].
        notices: what could not be read.
    """

    path: Path
    sha256: str
    about: dict[str, str]
    cell: CellModel
    robots: dict[str, RobotRun]
    begin_ns: int = 0
    length_s: float = 0.0
    gates: list[str] = field(default_factory=list)
    events: list[RunEvent] = field(default_factory=list)
    nearest: list[tuple[float, float]] = field(default_factory=list)
    least: tuple[NearestPair, float] | None = None
    notices: list[str] = field(default_factory=list)

    @property
    def cycle_s(self) -> float:
        """Cycle of the cell [s]."""
        return self.cell.description.cycle_s


def read_run(path: Path, on_progress: Callable[[int, int], None] | None = None) -> RecordedRun:
    """Read a recording to its end, or as far as it goes.

    Args:
        path: the file.
        on_progress: called with the bytes read and the bytes in all.

    Raises:
        UnreadableRecordingError: it is no recording.
        CellError: this version cannot read the recorded cell.
        EmptyRecordingError: no robot has a state in it.
    """
    recording = Recording.open(path)
    cell = recording.cell()
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    summaries = cell.description_message().robots
    run = RecordedRun(
        path, sha256, recording.about, cell, {name: RobotRun(name, summaries[name]) for name in cell.robots}
    )
    reader, size = _Reader(run), recording.size
    for count, item in enumerate(recording.messages(READ)):
        reader.take(item)
        if on_progress is not None and count % 256 == 0:
            on_progress(item.position, size)
    run.notices = list(recording.notices)
    if not any(robot.time_s.size for robot in run.robots.values()):
        why = f": {run.notices[0]}" if run.notices else ""
        raise EmptyRecordingError(
            f"{path} has no state of any robot{why}; there is nothing to report. "
            "Record while the cell is up: `deltaq record FILE`"
        )
    run.events.sort(key=lambda event: event.time_s)
    return run


class _Reader:
    """Sorts messages into a run."""

    def __init__(self, run: RecordedRun) -> None:
        self._run = run
        self._begin_ns: int | None = None
        self._commands: dict[int, Command] = {}
        self._faults: dict[tuple[str, str], tuple[float, RunEvent]] = {}
        self._state_s: dict[str, float] = {}

    def take(self, item: Recorded) -> None:
        run = self._run
        if self._begin_ns is None:
            self._begin_ns = run.begin_ns = item.time_ns
        time_s = (item.time_ns - self._begin_ns) / 1e9
        run.length_s = max(run.length_s, time_s)
        match item.message:
            case RobotState() as state if self._is_of_the_cell(state):
                self._state(state, time_s)
            case Verdict() as verdict if verdict.robot in run.robots:
                run.robots[verdict.robot].add_verdict(verdict, time_s)
            case ServerState() as state if state.robot in run.robots:
                for name, count in run.robots[state.robot].add_server_state(state).items():
                    self._fault(state.robot, name, count, time_s)
            case Proximity(pairs=pairs) if pairs:
                self._near(pairs[0], time_s)
            case Command() as command if command.kind in ("stop", "reset"):
                self._commands[command.id] = command
            case CommandReply() as reply:
                self._replied(reply, time_s)
            case GateMemory(fingerprint=fingerprint):
                self._gate(fingerprint)

    def _gate(self, fingerprint: str) -> None:
        if fingerprint and fingerprint not in self._run.gates:
            self._run.gates.append(fingerprint)

    def _is_of_the_cell(self, state: RobotState) -> bool:
        robot = self._run.robots.get(state.robot)
        return robot is not None and len(state.q) == len(robot.summary.joints)

    def _state(self, state: RobotState, time_s: float) -> None:
        run = self._run
        robot = run.robots[state.robot]
        self._gate(state.gate)
        before_s = self._state_s.get(state.robot)
        if before_s is not None and time_s - before_s > _SILENT_CYCLES * run.cycle_s:
            text = f"no states for {time_s - before_s:.2f} s"
            run.events.append(RunEvent(before_s, RunEventKind.GAP, state.robot, text))
        self._state_s[state.robot] = time_s
        was_held = bool(robot.phases) and robot.phases[-1][1] is Phase.HELD
        changes = len(robot.phases)
        robot.add_state(state, time_s, run.cycle_s)
        if len(robot.phases) == changes:
            return
        if state.phase is Phase.HELD:
            text = f"held: {state.reason.value if state.reason else 'no reason given'}"
            run.events.append(RunEvent(time_s, RunEventKind.HOLD, state.robot, text))
        elif was_held:
            run.events.append(
                RunEvent(time_s, RunEventKind.RESET, state.robot, f"no longer held: {state.phase.value}")
            )

    def _fault(self, robot: str, name: str, count: int, time_s: float) -> None:
        if name.startswith("held_"):
            return  # the state says so itself
        last_s, event = self._faults.get((robot, name), (-1.0, None))
        if event is not None and time_s - last_s <= _SAME_EVENT_S:
            event.count += count
        else:
            event = RunEvent(time_s, RunEventKind.FAULT, robot, name, count)
            self._run.events.append(event)
        self._faults[robot, name] = time_s, event

    def _near(self, nearest: NearestPair, time_s: float) -> None:
        run = self._run
        run.nearest.append((time_s, nearest.distance_m))
        if run.least is None or nearest.distance_m < run.least[0].distance_m:
            run.least = nearest, time_s

    def _replied(self, reply: CommandReply, time_s: float) -> None:
        command = self._commands.pop(reply.id, None)
        if command is None:
            return
        robot = command.robot or ""
        if command.kind == "stop":
            self._run.events.append(
                RunEvent(time_s, RunEventKind.STOP, robot, f"stop: {command.reason.value}")
            )
        elif not reply.accepted:
            why = reply.code.value if reply.code else reply.message
            self._run.events.append(RunEvent(time_s, RunEventKind.RESET, robot, f"reset refused: {why}"))
