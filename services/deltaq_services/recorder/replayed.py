"""A recording for the console: the robots' configurations at even times, verdicts other than admitted, and notes.

`python -m deltaq_services.recorder.replayed FILE --identity IDENTITY` prints it as one JSON object. Reading takes
processor time, and so it is a process of its own, behind all others.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from deltaq_cell.sight_lines import focus_of
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditEntry, AuditKind
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.messages import Outcome, Phase, Proximity, RobotState, Verdict
from deltaq_protocol.reasons import EXPLANATIONS
from deltaq_services.process import run
from deltaq_services.recorder.protobuf import PICTURE, PictureReference
from deltaq_services.recorder.reader import Recording

PERIOD_S = 0.04
MOST_TICKS = 60_000
"""Greatest number of steps; a recording of more than 40 minutes gets longer steps."""
STALE_S = 0.25
"""A robot without a state for this time is shown as silent."""
VERDICT_S = 0.5
SAME_S = 2.0
"""The same reason again within this is one line of the list."""
NO_STATE = -1
_NICENESS = 10
_PHASES, _OUTCOMES = tuple(Phase), tuple(Outcome)


class OtherCellRecordedError(DeltaqError):
    """The recording is of another cell than the shown one."""


class EmptyReplayError(DeltaqError):
    """The recording has no state of any robot."""


def replayed(path: Path, identity: str, most_ticks: int = MOST_TICKS) -> dict[str, Any]:
    """The recording as a JSON object; times from its beginning [s], joints in rad or m.

    It has `name`, `source`, `begin_s` (time of day, if recorded live), the step `period_s`, for each of `robots` a list
    a step of `q`, `phase`, `outcome`, `clearance_m`, `focus` and `coupled`, `nearest` (the nearest pair of each step),
    `verdicts` (those other than admitted, and notes), `pictures` (of each live stream time and file) and `notices` of
    damage.

    Args:
        path: the file.
        identity: of the cell in whose scene it is shown.
        most_ticks: greatest number of times in the result; the step is doubled until they suffice.

    Raises:
        UnreadableRecordingError: the file is not a recording.
        OtherCellRecordedError: it is of another cell.
        EmptyReplayError: no robot has a state in it.
    """
    recording = Recording.open(path)
    theirs, ours = CellIdentity.parse(recording.about.get("identity", "")), CellIdentity.parse(identity)
    if not ours.is_same(theirs):
        raise OtherCellRecordedError(mismatch(path.name, theirs, ours))
    track = _Track(recording.robots, most_ticks)
    begin_ns: int | None = None
    for item in recording.messages((topics.STATE, topics.VERDICT, topics.PROXIMITY, topics.AUDIT, PICTURE)):
        begin_ns = item.time_ns if begin_ns is None else begin_ns
        time_s = (item.time_ns - begin_ns) / 1e9
        track.go_on(time_s)
        match item.message:
            case RobotState() as state:
                track.states[state.robot] = (time_s, state)
            case Verdict() as verdict:
                track.take_verdict(verdict, time_s)
            case AuditEntry(what=AuditKind.NOTE) as note:
                track.add_line(time_s, robot=note.robot, outcome="note", code=None, what="", text=note.text)
            case PictureReference() as kept:
                taken_s = round(kept.captured_s - begin_ns / 1e9, 3)
                track.pictures.setdefault(kept.stream, []).append((taken_s, kept.file))
            case Proximity(pairs=pairs) if pairs:
                near = pairs[0]
                track.nearest.append([time_s, *near.pair, near.distance_m, *near.points_m])
    track.tick()
    if not track.states:
        raise EmptyReplayError(f"{path.name} has no state of any robot: there is nothing to show")
    return {
        "name": path.name,
        "begin_s": None if recording.about.get("source") != "live" else (begin_ns or 0) / 1e9,
        "source": recording.about.get("source", ""),
        "period_s": track.period_s,
        "robots": track.ticks,
        "nearest": track.nearest,
        "verdicts": track.verdicts,
        "pictures": track.pictures,
        "notices": recording.notices,
    }


class _Track:
    """The data of each step."""

    def __init__(self, robots: tuple[str, ...], most_ticks: int) -> None:
        self.period_s = PERIOD_S
        self.states: dict[str, tuple[float, RobotState]] = {}
        self.ticks: dict[str, dict[str, list[Any]]] = {
            name: {"q": [], "phase": [], "outcome": [], "clearance_m": [], "focus": [], "coupled": []}
            for name in robots
        }
        self.nearest: list[list[Any]] = []
        self.verdicts: list[dict[str, Any]] = []
        self.pictures: dict[str, list[tuple[float, str]]] = {}
        self._newest: dict[str, tuple[float, Verdict]] = {}
        self._last: dict[tuple[Any, ...], dict[str, Any]] = {}
        self._most_ticks = most_ticks
        self._count = 0

    def go_on(self, time_s: float) -> None:
        """Note every tick before this time."""
        while time_s > self._most_ticks * self.period_s:
            self._thin()
        while self._count * self.period_s < time_s:
            self.tick()

    def tick(self) -> None:
        """Note where everything is."""
        now_s = self._count * self.period_s
        for name, columns in self.ticks.items():
            told_s, state = self.states.get(name, (0.0, None))
            is_old = state is None or now_s - told_s > STALE_S
            columns["q"].append(None if state is None else [round(q, 5) for q in state.q])
            columns["phase"].append(NO_STATE if is_old or state is None else _PHASES.index(state.phase))
            judged_s, verdict = self._newest.get(name, (0.0, None))
            if verdict is not None and now_s - judged_s > VERDICT_S:
                verdict = None
            columns["outcome"].append(None if verdict is None else _OUTCOMES.index(verdict.outcome))
            columns["clearance_m"].append(None if verdict is None else verdict.clearance_m)
            columns["focus"].append(None if is_old or state is None else self._focus(state))
            columns["coupled"].append(None if state is None else state.coupled)
        self._count += 1

    def _focus(self, state: RobotState) -> list[float] | None:
        """What the robot's camera looks at, in the world [m]; None if it did not say."""
        if state.target is None:
            return None
        _, leader = self.states.get(state.target.leader or "", (0.0, None))
        focus = focus_of(state.target, None if leader is None else leader.tool)
        return None if focus is None else [round(x, 5) for x in focus]

    def take_verdict(self, verdict: Verdict, time_s: float) -> None:
        self._newest[verdict.robot] = (time_s, verdict)
        if verdict.outcome is Outcome.ADMITTED:
            return
        reason = verdict.reasons[0] if verdict.reasons else None
        text = "no reason given" if reason is None else EXPLANATIONS[reason.code]
        self.add_line(
            time_s,
            robot=verdict.robot,
            outcome=verdict.outcome.value,
            code=reason.code.value if reason else None,
            what=reason.what if reason else "",
            text=f"{text} ({reason.what})" if reason and reason.what else text,
        )

    def add_line(self, time_s: float, **line: str | None) -> None:
        """Add a line to the list, or count on that which says the same."""
        key = tuple(line.values())
        before = self._last.get(key)
        if before is not None and time_s - before["until_s"] <= SAME_S:
            before["until_s"] = time_s
            before["count"] += 1
            return
        self._last[key] = {"time_s": time_s, "until_s": time_s, "count": 1, **line}
        self.verdicts.append(self._last[key])

    def _thin(self) -> None:
        self.period_s *= 2.0
        for columns in self.ticks.values():
            for column in columns.values():
                del column[1::2]
        self._count = (self._count + 1) // 2


def main() -> None:
    """Print a recording as JSON."""
    parser = argparse.ArgumentParser(description="Print a recording as the console shows it")
    parser.add_argument("file", type=Path, help="MCAP file that deltaq recorded")
    parser.add_argument("--identity", required=True, help="identity of the cell in whose scene it is shown")
    options = parser.parse_args()
    os.nice(_NICENESS)
    json.dump(replayed(options.file, options.identity), sys.stdout, separators=(",", ":"), allow_nan=False)


if __name__ == "__main__":
    run(main, "replay")
