"""Figures of a recording: motion and verdicts of each robot, and events."""

import hashlib
from array import array
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.audit import AuditEntry, AuditKind
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import Command, CommandReply, GateMemory, ServerState
from deltaq_protocol.messages import (
    NearestPair,
    Outcome,
    Phase,
    Proximity,
    Reason,
    RobotState,
    RobotSummary,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.recorder.reader import Recorded, Recording

ORDINARY_COUNTERS = frozenset({"admissions", "braked_cycles", "braked_cycles_no_admission"})
"""Counters of a Robot Server that grow while nothing is wrong."""


@dataclass
class ReasonGroup:
    """Verdicts with the same outcome, whose first reason has the same code.

    Attributes:
        outcome: scaled, held or refused.
        code: of the first reason; None where the verdict gave none.
        count: of the verdicts.
        first_s: time of the first one [s].
        last_s: time of the last one [s].
        limits: how often each limit was named, e.g. a joint or two bodies.
    """

    outcome: Outcome
    code: ReasonCode | None
    count: int = 0
    first_s: float = 0.0
    last_s: float = 0.0
    limits: Counter[str] = field(default_factory=Counter)

    def add(self, time_s: float, reason: Reason | None) -> None:
        """Count one more verdict."""
        if not self.count:
            self.first_s = time_s
        self.count += 1
        self.last_s = time_s
        if reason is not None and reason.what:
            self.limits[reason.what] += 1


class RobotRun:
    """One robot of a recording.

    Args:
        name: of the robot.
        summary: its joints and their limits.

    Attributes:
        phases: (time [s], phase, reason) whenever one of the two changed.
        missed_cycles: cycle numbers that no state had.
        restarts: number of restarts of its cycle count.
        outcomes: verdicts by outcome.
        bound_s: times of the verdicts that did not admit as requested [s].
        reasons: those verdicts by outcome and reason.
        counters: increase of each counter of its Robot Server.
        least_clearance: least clearance of a verdict [m], its pair and time [s]; None if no verdict had one.
    """

    def __init__(self, name: str, summary: RobotSummary) -> None:
        self.name, self.summary = name, summary
        self.phases: list[tuple[float, Phase, ReasonCode | None]] = []
        self.missed_cycles = 0
        self.restarts = 0
        self.outcomes: Counter[Outcome] = Counter()
        self.bound_s: list[float] = []
        self.reasons: dict[tuple[Outcome, ReasonCode | None], ReasonGroup] = {}
        self.counters: Counter[str] = Counter()
        self.least_clearance: tuple[float, tuple[str, str] | None, float] | None = None
        self._time_s, self._q = array("d"), array("d")
        self._clearance = array("d")
        self._fastest = np.zeros(len(summary.joints))
        self._last: RobotState | None = None
        self._last_server: ServerState | None = None
        self._driven_cycles = self._cycles_since = 0

    def add_state(self, state: RobotState, time_s: float, cycle_s: float) -> None:
        """One cycle."""
        before = self._last
        if before is None or (before.phase, before.reason) != (state.phase, state.reason):
            self.phases.append((time_s, state.phase, state.reason))
        if before is not None:
            steps = state.cycle - before.cycle
            self.restarts += steps <= 0
            self.missed_cycles += max(steps - 1, 0)
            if steps == 1:
                speed = np.abs(np.subtract(state.q_cmd, before.q_cmd)) / cycle_s
                self._fastest = np.maximum(self._fastest, speed)
        self._time_s.append(time_s)
        self._q.extend(state.q)
        self._last = state

    def add_verdict(self, verdict: Verdict, time_s: float) -> None:
        """One decision of the gate, or a refusal before it."""
        self.outcomes[verdict.outcome] += 1
        if verdict.clearance_m is not None:
            self._clearance.extend((time_s, verdict.clearance_m))
            if self.least_clearance is None or verdict.clearance_m < self.least_clearance[0]:
                self.least_clearance = verdict.clearance_m, verdict.pair, time_s
        if verdict.outcome is Outcome.ADMITTED:
            return
        self.bound_s.append(time_s)
        reason = verdict.reasons[0] if verdict.reasons else None
        code = None if reason is None else reason.code
        group = self.reasons.setdefault((verdict.outcome, code), ReasonGroup(verdict.outcome, code))
        group.add(time_s, reason)

    def add_server_state(self, state: ServerState) -> dict[str, int]:
        """One cycle of the Robot Server; returns how much each extraordinary counter grew."""
        before, self._last_server = self._last_server, state
        if before is None or before.process != state.process:
            return {}
        self._cycles_since += max(state.cycle - before.cycle, 0)
        grown = {
            name: count - before.counters.get(name, 0)
            for name, count in state.counters.items()
            if count > before.counters.get(name, 0)
        }
        if "admissions" in grown:
            # before the first and after the last one the robot has no driver
            self._driven_cycles += self._cycles_since if self.counters["admissions"] else grown["admissions"]
            self._cycles_since = 0
        self.counters.update(grown)
        return {name: count for name, count in grown.items() if name not in ORDINARY_COUNTERS}

    @property
    def time_s(self) -> Array:
        """(k,) times of the states [s]."""
        return np.array(self._time_s)

    @property
    def q(self) -> Array:
        """(k, n) measured joints [rad or m]."""
        return np.array(self._q).reshape(-1, len(self.summary.joints))

    @property
    def clearance(self) -> Array:
        """(k, 2) time [s] and clearance [m] of the verdicts that had one."""
        return np.array(self._clearance).reshape(-1, 2)

    @property
    def fastest(self) -> Array:
        """(n,) greatest commanded speed of each joint as a share of its limit."""
        return np.divide(self._fastest, self.summary.max_velocity)

    @property
    def admission_rate(self) -> float | None:
        """Share of the cycles in which a fresh, admitted increment reached the robot, from the first to the last.

        None without any.
        """
        return self.counters["admissions"] / self._driven_cycles if self._driven_cycles else None

    @property
    def intervals_s(self) -> tuple[float, float, float] | None:
        """Median, 99th percentile and longest time between two states [s]; None with fewer than two."""
        if len(self._time_s) < 2:
            return None
        steps = np.diff(self.time_s)
        return float(np.median(steps)), float(np.quantile(steps, 0.99)), float(steps.max())


READ = (
    topics.STATE,
    topics.VERDICT,
    topics.PROXIMITY,
    topics.SERVER_STATE,
    topics.COMMAND,
    topics.COMMAND_REPLY,
    topics.GATE_MEMORY,
    topics.AUDIT,
)
_SILENT_CYCLES = 10
"""States that fail to come for so many cycles are an event."""
_SAME_EVENT_S = 1.0
"""The same fault within this time is one event."""


class RunEventKind(StrEnum):
    """What an event is about."""

    STOP = "stop"
    HOLD = "hold"
    RESET = "reset"
    FAULT = "fault"
    GAP = "gap"
    NOTE = "note"


@dataclass
class RunEvent:
    """An event for the operator.

    Attributes:
        time_s: from the beginning of the recording [s].
        kind: its kind.
        robot: its name; empty if it concerns the cell.
        text: for the report.
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
        notices: faults in the recording.
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
    """Read a recording to its end, or up to its damage.

    Args:
        path: the file.
        on_progress: called with the bytes read and the bytes in all.

    Raises:
        UnreadableRecordingError: it is no recording.
        CellError: this version cannot read the recorded cell.
        DeltaqError: no robot has a state in it.
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
        raise DeltaqError(
            f"{path} has no state of any robot{why}; there is nothing to report. "
            "Record while the cell is up: `deltaq recording record --output FILE`"
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
            case AuditEntry(what=AuditKind.NOTE) as entry:
                run.events.append(RunEvent(time_s, RunEventKind.NOTE, entry.robot or "", entry.text))
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
