"""Path to a pose of a hand, straight in joint space, and its clear part, computed on a copy of the cell."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.robot import RobotModel
from deltaq_controllers.advisor.advisor import Option, Progress
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.session import Answered
from deltaq_controllers.advisor.time_parameterisation import timed
from deltaq_controllers.criteria.near_bodies import Clearance
from deltaq_controllers.interface import ControllerError, RobotView, View
from deltaq_controllers.inverse.tracking import ConstraintTracker, TrackingError
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.practice import CYCLES
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode, NearPair, OperatorCommand, Search, Way

# Reports of offered paths: options of the advisor, or the path to a pose.


_DECIMALS = 5
"""Of what is only drawn [rad or m]."""


def option_way(rank: int, option: Option) -> Way:
    """An option of the advisor; its rank counts from 1."""
    return Way(
        rank=rank,
        q=joints(option.q),
        points=() if option.path is None else points(option.path),
        why_not="" if option.path is not None else option.no_path,
        energy=option.energy,
        energy_here=option.energy_here if np.isfinite(option.energy_here) else None,
        costs=option.costs,
        near={
            kind.name.lower(): NearPair(distance_m=one.distance_m, pair=one.pair)
            for kind, one in option.nearest.items()
        },
        hands_leave=option.hands_leave,
        clearance_m=option.clearance.distance_m,
        pair=option.clearance.pair,
        nearest_limit=option.nearest_limit,
        limit_share=option.limit_share,
    )


def advisor_of(teleoperator: Teleoperator) -> AdvisorMode | None:
    """The mode `advisor`, if it drives now."""
    made = next((mode for mode in teleoperator.made_modes if mode.name is teleoperator.mode), None)
    return made if isinstance(made, AdvisorMode) else None


def search_of(mode: AdvisorMode) -> Search:
    """Progress of the search of mode advisor, and of the robot on the chosen path."""
    progress = mode.search
    return Search(
        doing="" if progress is None else progress.doing,
        done=0.0 if progress is None else min(1.0, max(0.0, progress.done)),
        is_busy=mode.is_searching,
        trials=0 if progress is None else progress.trials,
        way=mode.begun,
        driven=round(mode.driven, 3),
        arrived=mode.is_at_end,
        trade_off=mode.trade_off,
        hands_may_leave=mode.hands_may_leave,
    )


def points(path: Array, most: int = 32) -> tuple[tuple[float, ...], ...]:
    """Configurations of a path (P, n), no more than are drawn, including its ends."""
    count = min(len(path), most)
    return tuple(joints(path[index]) for index in np.linspace(0, len(path) - 1, count).round().astype(int))


def joints(q: Array) -> tuple[float, ...]:
    """A configuration (n,), in the form in which it is drawn."""
    return tuple(np.round(q, _DECIMALS).tolist())


STEP = 0.01
"""Distance between two configurations of a way that are looked at, in the joint that moves most [rad or m]."""
_SAMPLES = 400
_SHARES = (0.1, 0.3, 1.0)
"""How far the base goes towards each sample of its range."""
_TRIED = 6
"""Ends whose ways are looked at, the quickest first."""
PRACTISED_RAD = 0.05
"""Motion of each joint of an arm on the practised path [rad or m]."""


@dataclass(frozen=True)
class PlannedReach:
    """A drivable path, and its description for the operator."""

    teleoperator: Teleoperator
    way: Way


class ReachPlanner:
    """Plans paths of one robot of a cell, with the other robots at rest.

    Args:
        cell: a copy of the model, for this planner alone.
        robot: name of the robot.

    Raises:
        ControllerError: the robot's arms have no inverse.
    """

    def __init__(self, cell: CellModel, robot: str) -> None:
        self._robot: RobotModel = cell.robots[robot]
        self._cycle_s = cell.description.cycle_s
        try:
            self._tracker = ConstraintTracker(self._robot)
        except TrackingError as error:
            raise ControllerError(f"mode pose: {error}") from None
        self._exact = ExactClearance(cell, robot)
        # the same samples every time: a pose that is dragged a little leads to a way that differs a little
        self._samples = np.random.default_rng(0).uniform(size=(_SAMPLES, len(self._tracker.base)))

    def practise(self) -> None:
        """Plan a short way from home, and drive its beginning on the model: the first real one waits for nothing."""
        robot, (arm, *_) = self._robot, self._tracker.arms
        end = robot.home.copy()
        inwards = np.sign(robot.lower + robot.upper - 2.0 * end)[arm.joints]
        end[arm.joints] += PRACTISED_RAD * inwards
        T = self._tracker.hands(end)[0]
        turn = pin.Quaternion(T[:3, :3])
        x, y, z = T[:3, 3].tolist()
        try:
            planned = self.plan(robot.home, {}, robot.hands[0], (x, y, z), (turn.w, turn.x, turn.y, turn.z))
        except ControllerError:
            return  # not even this can be reached from home: there is nothing to be ready for
        teleoperator, q = planned.teleoperator, robot.home
        for cycle in range(CYCLES):
            teleoperator.command = OperatorCommand(option=1)
            q = q + teleoperator.increment(View(RobotView(cycle, cycle * self._cycle_s, q, q)))

    def plan(
        self,
        q: Array,
        others: Mapping[str, Array],
        hand: str,
        position_m: tuple[float, float, float],
        quaternion_wxyz: tuple[float, float, float, float],
    ) -> PlannedReach:
        """Plan the path of a hand to a pose in the world; other hands do not move.

        Args:
            q: (n,) setpoint at which the robot rests.
            others: (n,) setpoint of each other robot.
            hand: its name; empty for a robot with one hand.
            position_m: of the hand in the world.
            quaternion_wxyz: of the hand in the world, of any length but zero.

        Raises:
            ControllerError: an unknown hand, no rotation, or a pose that is out of reach.
        """
        T_world_hands = self._tracker.hands(q)
        T_world_hands[self._index_of(hand)] = _pose(position_m, quaternion_wxyz)
        self._exact.place(others)
        best: tuple[Array, int] | None = None
        for end in self._ends(q, T_world_hands)[:_TRIED]:
            path = _straight(q, end)
            clear = self._clear_until(path)
            if best is None or clear / len(path) > best[1] / len(best[0]):
                best = path, clear
            if clear == len(path):
                break
        if best is None:
            raise ControllerError(
                f"{self._robot.name} cannot bring its hand there: it is out of reach, or a joint would pass its limit"
            )
        return self._planned(*best)

    def plan_joints(self, q: Array, others: Mapping[str, Array], end: Sequence[float]) -> PlannedReach:
        """Plan the path to a configuration.

        Args:
            q: (n,) setpoint at which the robot rests.
            others: (n,) setpoint of each other robot.
            end: (n,) configuration at its end [rad or m].

        Raises:
            ControllerError: not an element for each joint, or one beyond its limit.
        """
        robot = self._robot
        if len(end) != robot.n:
            raise ControllerError(f"q: {robot.name} has {robot.n} joints, got {len(end)} elements")
        for joint, value, lower, upper in zip(robot.joint_names, end, robot.lower, robot.upper, strict=True):
            if not lower <= value <= upper:
                raise ControllerError(
                    f"q: {joint} at {value:g} is beyond its limits; bounds {lower:g} and {upper:g}"
                )
        self._exact.place(others)
        path = _straight(q, np.array(end))
        return self._planned(path, self._clear_until(path))

    def _index_of(self, hand: str) -> int:
        hands = self._robot.hands
        if not hand and len(hands) == 1:
            return 0
        if hand not in hands:
            raise ControllerError(f"hand: {self._robot.name} has no hand {hand!r}; it has {', '.join(hands)}")
        return hands.index(hand)

    def _ends(self, q: Array, T_world_hands: Array) -> Array:
        """(N, n) configurations with the hands there: first one with the base where it is, then the quickest."""
        base, robot = self._tracker.base, self._robot
        bases = [q[None, base]]
        if len(base):
            reached = robot.lower[base] + self._samples * (robot.upper - robot.lower)[base]
            bases += [q[base] + share * (reached - q[base]) for share in _SHARES]
        ends = self._tracker.track(np.concatenate(bases), T_world_hands, q)
        duration = (np.abs(ends - q) / robot.max_velocity).max(axis=1)
        duration[0] *= 0.0  # a base that need not move does not; NaN stays NaN
        order = np.argsort(duration)
        found: Array = ends[order[np.isfinite(duration[order])]]
        return found

    def _clear_until(self, path: Array) -> int:
        """How many configurations of a path (P, n) keep all distances, from the first on."""
        for index in range(len(path)):
            if not self._exact.keeps(path[index : index + 1]):
                return index
        return len(path)

    def _planned(self, path: Array, clear: int) -> PlannedReach:
        end = path[-1]
        tightest = self._exact.tightest(path[: clear + 1])
        share = 1.0 if clear == len(path) else clear / len(path)
        answered = Answered(self._tracker, Progress("", 1.0, 0.0, 0, (Option.along(path, tightest),)))
        modes = {DrivingMode.ADVISOR: lambda robot: AdvisorMode(robot, self._cycle_s, answered)}
        setpoints = timed(path, self._tracker, self._cycle_s, hands_move=True)
        first = setpoints[min(1, len(setpoints) - 1)] - setpoints[0]
        way = Way(
            rank=1,
            q=joints(end),
            points=points(path),
            clearance_m=tightest.distance_m,
            pair=tightest.pair,
            clear=share,
            text=_words(share, tightest),
            first=tuple(first.tolist()),
        )
        return PlannedReach(Teleoperator(self._robot, self._cycle_s, DrivingMode.ADVISOR, modes=modes), way)


def _pose(
    position_m: tuple[float, float, float], quaternion_wxyz: tuple[float, float, float, float]
) -> Array:
    w, x, y, z = quaternion_wxyz
    size = float(np.linalg.norm(quaternion_wxyz))
    if size < 1e-6:
        raise ControllerError("quaternion_wxyz: is not a rotation, all elements are zero")
    T = np.eye(4)
    T[:3, :3] = pin.Quaternion(w / size, x / size, y / size, z / size).matrix()
    T[:3, 3] = position_m
    return T


def _straight(q: Array, end: Array) -> Array:
    pieces = max(1, int(np.ceil(np.abs(end - q).max() / STEP)))
    path: Array = q + np.linspace(0.0, 1.0, pieces + 1)[:, None] * (end - q)
    path[0], path[-1] = q, end
    return path


def _words(share: float, tightest: Clearance) -> str:
    near = f"{100 * tightest.distance_m:.1f} cm between {' and '.join(tightest.pair)}"
    if share == 1.0:
        return f"clear on the whole path, at least {near}"
    kept_cm = 100 * (tightest.distance_m - tightest.room_m)
    return f"clear for {share:.0%} of the path, then {near}; {kept_cm:.1f} cm are kept"
