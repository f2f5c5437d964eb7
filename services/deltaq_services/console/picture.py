"""The newest states, verdicts and near bodies of the cell, and the frame with them for browsers."""

from collections.abc import Mapping

from deltaq_cell.description import CellDescription
from deltaq_cell.roles import camera_roles
from deltaq_cell.sight_lines import focus_of
from deltaq_protocol.messages import (
    NearestPair,
    Phase,
    Proximity,
    RobotState,
    Sight,
    Vector3,
    Verdict,
    ViewTarget,
)
from deltaq_services.console.feed import pack_frame
from deltaq_services.console.messages import SIGHTS, bound_of, phase_words
from deltaq_services.console.robot_side import RobotSide
from deltaq_services.console.status_board import EventLog


class Picture:
    """The camera views of one cell.

    Args:
        cell: its description.
        bodies: names of its bodies, as the scene lists them.
        robots: each robot's side.
        log: gets a line for each change.
    """

    def __init__(
        self, cell: CellDescription, bodies: tuple[str, ...], robots: Mapping[str, RobotSide], log: EventLog
    ) -> None:
        self._places = {name: place for place, name in enumerate(bodies)}
        self._robots = robots
        self._watched = _watched(cell)
        self._log = log
        self._nearest: NearestPair | None = None
        self._phases: dict[str, tuple[Phase, str | None]] = {}
        self._views: dict[str, tuple[ViewTarget, Sight | None]] = {}

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
        self._log_view(state, arrived_s)

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
        self._nearest = proximity.pairs[0] if proximity.pairs else None

    def frame(self, now_s: float) -> bytes:
        """The frame of this moment."""
        robots = [side.feed.packed(now_s, self._focus(name)) for name, side in self._robots.items()]
        return pack_frame(now_s, self._nearest, self._places, robots)

    def _log_view(self, state: RobotState, arrived_s: float) -> None:
        """Log a camera's target, and how well it is seen, when either changes."""
        if state.target is None:
            self._views.pop(state.robot, None)
            return
        target, sight = self._views.get(state.robot, (None, Sight.FRESH))
        self._views[state.robot] = (state.target, state.sight)
        if state.target != target:
            self._log.add(arrived_s, "view", f"its camera looks at {state.target.words()}", state.robot)
        if state.sight is not None and state.sight is not sight:
            self._log.add(arrived_s, "view", SIGHTS[state.sight], state.robot)

    def _focus(self, name: str) -> Vector3 | None:
        """The target of a robot's camera; without a controller the tool that it watches by default."""
        state = self._robots[name].feed.state
        watched = self._watched.get(name)
        target = state.target if state is not None and state.target is not None else watched
        if watched is None or target is None:
            return None
        leader = self._robots.get(target.leader or "")
        seen = None if leader is None else leader.feed.state
        return focus_of(target, None if seen is None else seen.tool)


def _watched(cell: CellDescription) -> dict[str, ViewTarget]:
    """What each robot with a camera is there to watch."""
    cameras = [
        name for name, robot in cell.robots.items() if robot.camera is not None and len(cell.robots) > 1
    ]
    return {name: ViewTarget(leader=camera_roles(cell, name).leader) for name in cameras}
