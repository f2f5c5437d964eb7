"""The paper's Fig. 9 of a recording: how well the camera kept the leader in view, and where the gate stepped in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from deltaq_experiments.figures import draw
from deltaq_experiments.live import trace_of
from deltaq_experiments.panels import Marks, Panel
from deltaq_experiments.scene import FOLLOWER, LEADER, camera_controller
from deltaq_experiments.tracking import panels
from deltaq_protocol import topics
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Outcome, RobotState, Verdict
from deltaq_services.recorder.reader import Recording


def plot(path: Path, picture: Path) -> list[str]:
    """Draw the picture of a recording.

    Returns:
        What of the recording could not be read.

    Raises:
        DeltaqError: it is no recording of a camera and a leader, or the picture cannot be written.
    """
    recording = Recording.open(path)
    draw(
        panels_of(recording),
        f"{path.name}, cell {recording.about['cell']}, {recording.about['source']}",
        picture,
    )
    return recording.notices


def panels_of(recording: Recording) -> tuple[Panel, ...]:
    """View angle error with the gate's interventions, view distance, and the leader's path.

    Raises:
        DeltaqError: the recording has no states of the robots that the paper's experiments have.
    """
    states: list[RobotState] = []
    begin_ns: int | None = None
    bound: dict[str, list[float]] = {FOLLOWER: [], LEADER: []}
    for item in recording.messages((topics.STATE, topics.GATE_VERDICT)):
        begin_ns = item.time_ns if begin_ns is None else begin_ns
        if isinstance(item.message, RobotState):
            states.append(item.message)
        elif isinstance(item.message, Verdict) and item.message.outcome is not Outcome.ADMITTED:
            bound.setdefault(item.message.robot, []).append((item.time_ns - begin_ns) / 1e9)
    missing = {FOLLOWER, LEADER} - {state.robot for state in states}
    if missing:
        raise DeltaqError(
            f"{recording.path} has no states of {' and '.join(sorted(missing))}: the figure shows a camera on "
            f"{FOLLOWER} that follows {LEADER}"
        )
    cell = recording.cell()
    trace = trace_of(states, (FOLLOWER, LEADER), {})
    views = trace.views(camera_controller(cell), FOLLOWER, LEADER)
    first, *others = panels(cell, trace, views[:, 0], views[:, 1])
    marks = tuple(
        Marks(f"gate bound {name}", np.array(times), np.ones(len(times), dtype=bool))
        for name, times in bound.items()
        if times
    )
    return (replace(first, marks=marks), *others)
