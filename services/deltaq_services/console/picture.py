"""What is seen of the cell: states, verdicts and near bodies as they come, and the frame that shows them."""

from __future__ import annotations

from collections.abc import Mapping

from deltaq_cell.description import CellDescription
from deltaq_protocol.messages import Phase, Proximity, RobotState, Verdict
from deltaq_services.console.event_log import EventLog
from deltaq_services.console.frame import NO_BODY, Vector, WitnessedPair, pack_frame
from deltaq_services.console.robot_side import RobotSide
from deltaq_services.console.words import bound_of, phase_words


class Picture:
    """What is seen of one cell.

    Args:
        cell: its description.
        bodies: names of its bodies, as the scene lists them.
        robots: each robot's side.
        log: where changes are told.
    """

    def __init__(
        self, cell: CellDescription, bodies: tuple[str, ...], robots: Mapping[str, RobotSide], log: EventLog
    ) -> None:
        self._places = {name: place for place, name in enumerate(bodies)}
        self._robots = robots
        self._watched = _watched(cell)
        self._log = log
        self._nearest = WitnessedPair()
        self._phases: dict[str, tuple[Phase, str | None]] = {}

    def take_state(self, state: RobotState, arrived_s: float) -> None:
        """A robot's state."""
        side = self._robots.get(state.robot)
        if side is None or not side.feed.take_state(state, arrived_s):
            return
        phase = (state.phase, state.reason)
        before = self._phases.get(state.robot)
        self._phases[state.robot] = phase
        # ready, engaged and braking come and go with every motion
        if (
            before is not None
            and before != phase
            and (Phase.HELD in (phase[0], before[0]) or state.reason is not None)
        ):
            self._log.add(arrived_s, "phase", phase_words(state, is_stale=False)[0], state.robot)

    def take_verdict(self, verdict: Verdict, arrived_s: float) -> None:
        """A verdict on a robot's increment."""
        side = self._robots.get(verdict.robot)
        if side is None:
            return
        side.feed.take_verdict(verdict, arrived_s)
        side.bound = bound_of(verdict, side.units)
        if side.bound is not None:
            reason = verdict.reasons[0]
            group = f"{verdict.outcome} {reason.code} {reason.what}"
            self._log.repeat(arrived_s, "verdict", group, side.bound.text, verdict.robot)

    def take_proximity(self, proximity: Proximity) -> None:
        """The nearest bodies of the cell."""
        if not proximity.pairs:
            self._nearest = WitnessedPair()
            return
        nearest = proximity.pairs[0]
        a, b = (self._places.get(name, NO_BODY) for name in nearest.pair)
        self._nearest = WitnessedPair(a, b, nearest.distance_m, nearest.points_m)

    def frame(self, now_s: float) -> bytes:
        """The frame of this moment."""
        robots = [side.feed.frame(now_s) for side in self._robots.values()]
        return pack_frame(now_s, self._focus(), self._nearest, robots)

    def _focus(self) -> Vector | None:
        state = self._robots[self._watched].feed.state if self._watched else None
        return None if state is None else state.tool.position


def _watched(cell: CellDescription) -> str:
    """The robot that a camera looks at: the first that carries none; empty without a camera in the cell."""
    if all(robot.camera is None for robot in cell.robots.values()):
        return ""
    return next((name for name, robot in cell.robots.items() if robot.camera is None), "")
