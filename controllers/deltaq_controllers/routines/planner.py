"""Plans the motions of a routine: around bodies to a configuration, and the tool's straight lines at the equipment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import EquipmentDescription
from deltaq_cell.robot_bodies import placement
from deltaq_cell.sight_lines import SightLines
from deltaq_controllers.advisor.advisor import Option, Progress
from deltaq_controllers.advisor.exact import FINE_SHARE, LEAP, MARGIN_M, ExactClearance, HandsMoved
from deltaq_controllers.advisor.path_planner import NoPathError, PathPlanner
from deltaq_controllers.advisor.session import Answered
from deltaq_controllers.advisor.time_parameterisation import SHARE, timed
from deltaq_controllers.criteria.near_bodies import Clearance
from deltaq_controllers.inverse.tracking import ConstraintTracker, TrackingError
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.routines.routine import (
    Job,
    PlainStep,
    RoutineError,
    ToolMove,
    job_for,
    load_routine,
    shipped,
)
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import DrivingMode
from deltaq_protocol.messages import ViewTarget, ViewWish

LINE_M, TURN_RAD = 0.005, 0.03
"""Distance between two configurations of a line."""
TRIED = 60
"""Configurations in front of the equipment that are looked at."""
PLANNED = 4
"""Of those whose lines are clear, so many are planned to."""
SAMPLES = 300
"""Places of the base that are tried, in each of four shares of its range."""
INSIDE = 0.8
"""Of a body's half size, how far from its centre it is looked at."""
ROUNDS = 300
"""Growths of a tree in search of one path: nobody waits for it at a stick."""
LENSES = 8
CONE_RAD = 0.35
"""Places of the camera from which a posture is looked at, and the half angle of their cone [rad]."""
CONTACT_SHARE = 0.98
"""Of the speed that a contact allows: the gate then scales nothing."""


@dataclass(frozen=True)
class ToolPlace:
    """A place of the tool at the equipment: in the axes of the approach pose, turned about the equipment's axis."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    turn_rad: float = 0.0

    def moved(self, move: ToolMove) -> ToolPlace:
        """The place after a motion whose numbers are numbers."""
        to = {name: float(value) for name, value in move.model_dump(exclude_none=True).items()}
        by_m, turn_deg = to.pop("by_m", 0.0), to.pop("turn_deg", None)
        turn_rad = self.turn_rad if turn_deg is None else float(np.deg2rad(turn_deg))
        moved = replace(self, turn_rad=turn_rad, **to)
        return replace(moved, z_m=moved.z_m + by_m)


def points_of(cell: CellModel, item: EquipmentDescription) -> Array:
    """(5, 3) points of an item to look at: the centre of its first body, and four about it [m].

    A tool at work hides the centre from a camera behind it, but not all of the others.
    """
    name = f"structure/{item.bodies[0]}"
    body = next(body for body in cell.structure if body.name == name)
    body.geometry.computeLocalAABB()
    x, y, _ = 0.5 * (body.geometry.aabb_local.max_ - body.geometry.aabb_local.min_)
    off = INSIDE * np.array([(0, 0, 0), (x, 0, 0), (-x, 0, 0), (0, y, 0), (0, -y, 0)])
    points: Array = off @ body.placement.rotation.T + body.placement.translation
    return points


class WorkFrame:
    """The geometry of an item of equipment.

    Args:
        cell: the cell.
        item: with an approach pose.
    """

    def __init__(self, cell: CellModel, item: EquipmentDescription) -> None:
        assert item.approach is not None  # the routine was checked
        self._approach = placement(item.approach).homogeneous
        self._axis = np.array(item.axis or (0.0, 0.0, 1.0)) / np.linalg.norm(item.axis or (0.0, 0.0, 1.0))
        self.centre_m: Array = points_of(cell, item)[0]

    def pose(self, place: ToolPlace) -> Array:
        """`T_world_tool` (4, 4) at a place."""
        pose: Array = self._approach.copy()
        pose[:3, 3] += pose[:3, :3] @ (place.x_m, place.y_m, place.z_m)
        turn = pin.exp3(self._axis * place.turn_rad)
        pose[:3, :3] = turn @ pose[:3, :3]
        pose[:3, 3] = self.centre_m + turn @ (pose[:3, 3] - self.centre_m)
        return pose

    def place(self, pose: Array) -> ToolPlace:
        """The place of the tool at a pose `T_world_tool` (4, 4); turns beside the axis are left out."""
        turn_rad = float(pin.log3(pose[:3, :3] @ self._approach[:3, :3].T) @ self._axis)
        back = pin.exp3(-self._axis * turn_rad)
        position = self.centre_m + back @ (pose[:3, 3] - self.centre_m)
        x, y, z = (self._approach[:3, :3].T @ (position - self._approach[:3, 3])).tolist()
        return ToolPlace(x, y, z, turn_rad)


class ViewShares:
    """Ranks postures, and points of the equipment, by how well a camera can see it past the robot that works on it.

    The camera is elsewhere when the robot gets there, so the equipment is looked at from `LENSES` places in a cone
    about the camera's present line of sight.

    Args:
        cell: the cell.
        job: with a camera and an item.
    """

    def __init__(self, cell: CellModel, job: Job) -> None:
        assert job.camera is not None and job.item is not None  # noqa: PT018 # the caller has seen to it
        self._robot, self._camera, self._model = job.robot, job.camera, cell.robots[job.camera]
        self._lines, self._points = SightLines(cell), points_of(cell, job.item)
        self._distance_m = job.item.view_m
        self._lenses = self._points[:1]

    def place(self, others: Mapping[str, Array]) -> None:
        """Note where the other robots are, (n,) setpoint of each."""
        self._lines.place(others)
        lens = self._model.camera_pose(others.get(self._camera, self._model.home))[:3, 3]
        ahead = (lens - self._points[0]) / max(float(np.linalg.norm(lens - self._points[0])), 1e-6)
        around = np.linalg.svd(ahead[None])[2][1:]
        turns = np.linspace(0.0, 2.0 * np.pi, LENSES, endpoint=False)
        off = np.tan(CONE_RAD * np.sqrt(np.linspace(0.0, 1.0, LENSES)))[:, None]
        # by the golden angle: spread evenly over the cone
        golden = turns * LENSES * 0.381966
        towards = ahead + off * (np.cos(golden)[:, None] * around[0] + np.sin(golden)[:, None] * around[1])
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        self._lenses = self._points[0] + self._distance_m * towards

    def share(self, q: Array) -> float:
        """Share of the places from which the equipment is seen with the robot at `q` (n,)."""
        self._lines.place({self._robot: q})
        return float(np.mean([self._places(point) for point in self._points])) / len(self._lenses)

    def wish(self) -> ViewWish:
        """The view to ask for: the first point that the camera can see, those seen from most places first."""
        points = sorted(self._points.round(6), key=self._places, reverse=True)
        targets = tuple(ViewTarget(focus_m=(x, y, z)) for x, y, z in np.array(points).tolist())
        return ViewWish(targets=targets, distance_m=self._distance_m)

    def _places(self, point: Array) -> int:
        """From how many places a point (3,) is seen."""
        return sum(self._sees(lens, point) for lens in self._lenses)

    def _sees(self, lens: Array, point: Array) -> bool:
        bodies = self._lines.blocked_by(lens, point)
        at_point = self._lines.bodies_at(point) if bodies else ()
        return all(name in at_point or name.startswith(f"{self._camera}/") for name in bodies)


@dataclass(frozen=True)
class PlanRequest:
    """A motion to be planned.

    Attributes:
        plain: the step.
        q: (n,) setpoint at which the robot rests [rad or m].
        touching: whether the equipment's contact is allowed.
        ahead: motions of the tool after it, each with whether the contact is allowed then.
    """

    plain: PlainStep
    q: Array
    touching: bool
    ahead: tuple[tuple[ToolMove, bool], ...] = ()


@dataclass(frozen=True)
class PlannedMotion:
    """A motion that can be driven.

    Attributes:
        path: (P, n) configurations.
        clearance: of the tightest pair on it; pairs that may touch do not count.
        duration_s: without anything that slows it down.
        first: (n,) its first increment [rad or m].
        teleoperator: drives along it, as option 1.
    """

    path: Array
    clearance: Clearance
    duration_s: float
    first: Array
    teleoperator: Teleoperator


def lines_after(steps: Sequence[PlainStep], index: int, touching: bool) -> tuple[tuple[ToolMove, bool], ...]:
    """Motions of the tool after a step, to the next that moves elsewhere, each with whether it may touch."""
    ahead = []
    for plain in steps[index + 1 :]:
        if plain.step.move_to is not None:
            break
        if plain.step.contact is not None:
            touching = plain.step.contact == "allow"
        if plain.step.move_tool is not None:
            ahead.append((plain.step.move_tool, touching))
    return tuple(ahead)


def with_present_tools(cell: CellModel, job: Job, coupled: Mapping[str, str | None]) -> CellModel:
    """A cell with its present tools, for a planner; at a tool stand the changer itself is the tool.

    Args:
        cell: the cell, with all tools or any.
        job: the routine and its equipment.
        coupled: tool of each robot with a tool changer, as in its states.
    """
    placed = cell.with_tools(coupled)
    if job.item is None or job.item.kind != "tool_stand" or not coupled.get(job.robot, ""):
        return placed
    changer = cell.robots[job.robot].with_tool(coupled[job.robot], frame="")
    return CellModel.of(cell.description, {**placed.robots, job.robot: changer}, cell.yaml)


class RoutinePlanner:
    """Plans for one job, with the other robots where they are.

    Args:
        cell: a model of the cell, for this planner alone.
        job: the routine and its equipment.
        seed: of the paths.

    Raises:
        RoutineError: the robot has several hands, or its arm has no inverse.
    """

    def __init__(self, cell: CellModel, job: Job, seed: int = 0) -> None:
        self._robot, self._job = cell.robots[job.robot], job
        self._cycle_s = cell.description.cycle_s
        if len(self._robot.hands) > 1:
            raise RoutineError(
                f"routines are for robots with one hand; {job.robot} has {', '.join(self._robot.hands)}"
            )
        try:
            self._tracker = ConstraintTracker(self._robot)
        except TrackingError as error:
            raise RoutineError(str(error)) from None
        self._generator = np.random.default_rng(seed)
        self._samples = np.random.default_rng(0).uniform(size=(SAMPLES, len(self._tracker.base)))
        item = job.item
        self._frame = None if item is None or item.approach is None else WorkFrame(cell, item)
        self._clear = self._free = ExactClearance(cell, job.robot)
        has_view = job.camera is not None and item is not None
        self._views = ViewShares(cell, job) if has_view else None
        self._contact_speed = 1.0
        if item is not None and item.contact is not None:
            contact = cell.description.contacts[item.contact]
            self._free = ExactClearance(cell, job.robot, left_out=contact.pairs)
            self._contact_speed = CONTACT_SHARE * contact.speed

    def plan(self, request: PlanRequest, others: Mapping[str, Array]) -> PlannedMotion:
        """Plan a motion.

        Args:
            request: what is planned.
            others: (n,) setpoint of each other robot [rad or m].

        Raises:
            RoutineError: there is no way, or none was found; the text says why.
        """
        for exact in (self._clear, self._free):
            exact.place(others)
        if self._views is not None:
            self._views.place(others)
        step, q = request.plain.step, request.q
        if step.move_tool is not None:
            assert self._frame is not None  # the job was checked
            target = self._frame.place(self._robot.forward(q)).moved(step.move_tool)
            path = self._line(q, target, request.touching)
        elif step.move_to == "approach":
            path = self._to_approach(request)
        else:
            end = self._robot.home if step.move_to == "home" else np.array(step.move_to)
            path = self._around(request, end)
        return self._motion(path, step.speed, request.touching)

    def view(self, at_equipment: bool, others: Mapping[str, Array]) -> ViewWish:
        """What the camera is to look at: the equipment, or the tool of the robot that works; `others` as in `plan`."""
        if self._views is None or not at_equipment:
            return ViewWish(targets=(ViewTarget(leader=self._job.robot),))
        self._views.place(others)
        return self._views.wish()

    def _around(self, request: PlanRequest, end: Array) -> Array:
        if np.abs(end - request.q).max() == 0.0:
            return np.stack([end, end])
        exact = self._exact(request.touching)
        room_m = exact.measure(end).room_m
        if room_m <= 0.0:
            near = exact.measure(end)
            raise RoutineError(
                f"{request.plain.text}: {near.pair[0]} would be {near.distance_m:.3f} m from {near.pair[1]}, "
                f"nearer than the stop distance, {near.distance_m - room_m:.3f} m"
            )
        ways = PathPlanner(self._robot, HandsMoved(self._robot), exact, self._generator, request.q, ROUNDS)
        try:
            return ways.to(end)
        except NoPathError as error:
            raise RoutineError(f"{request.plain.text}: {error}") from None

    def check(self) -> None:
        """Check that some posture of the robot is clear in front of the equipment and on all lines from there.

        Raises:
            RoutineError: none is, or none was found.
        """
        for index, plain in enumerate(self._job.steps):
            if plain.step.move_to == "approach":
                ahead = lines_after(self._job.steps, index, touching=False)
                request = PlanRequest(plain, self._robot.home, touching=False, ahead=ahead)
                next(self._postures(request, seen_first=False))

    def _to_approach(self, request: PlanRequest) -> Array:
        for count, end in enumerate(self._postures(request), start=1):
            try:
                return self._around(request, end)
            except RoutineError:
                if count == PLANNED:
                    raise
        raise AssertionError  # postures end with an error

    def _postures(self, request: PlanRequest, seen_first: bool = True) -> Iterator[Array]:
        """Configurations (n,) in front of the equipment whose lines are clear: the best seen first, then the quickest.

        Raises:
            RoutineError: when there are no more.
        """
        assert self._frame is not None  # the job was checked
        q, base, robot = request.q, self._tracker.base, self._robot
        bases = [q[None, base]]
        if len(base):
            reached = robot.lower[base] + self._samples * (robot.upper - robot.lower)[base]
            bases += [q[base] + share * (reached - q[base]) for share in (0.1, 0.3, 0.6, 1.0)]
        pose = self._frame.pose(ToolPlace())
        ends = self._tracker.track(np.concatenate(bases), pose[None], q)
        ends = ends[np.isfinite(ends).all(axis=1)]
        if not len(ends):
            raise RoutineError(
                f"{request.plain.text}: {robot.name} cannot bring its tool there: it is out of reach, "
                "or a joint would pass its limit"
            )
        ends = ends[np.argsort((np.abs(ends - q) / robot.max_velocity).max(axis=1))]
        few = ends[:: max(1, len(ends) // TRIED)]
        clear: Array = few[self._exact(request.touching).kept(few, FINE_SHARE * MARGIN_M)]
        if self._views is not None and seen_first:
            shares = np.array([round(self._views.share(end), 1) for end in clear])
            clear = clear[np.argsort(-shares, kind="stable")]
        why = f"{request.plain.text}: in every posture there a body comes too near to another"
        for end in clear:
            try:
                self._try_lines(end, request)
            except RoutineError as error:
                why = str(error)
            else:
                yield end
        raise RoutineError(why)

    def _try_lines(self, q: Array, request: PlanRequest) -> None:
        place, reached = ToolPlace(), {ToolPlace(): q}
        for move, touching in request.ahead:
            target = place.moved(move)
            if target not in reached:
                reached[target] = self._line(reached[place], target, touching)[-1]
            place = target

    def _line(self, q: Array, target: ToolPlace, touching: bool) -> Array:
        """(P, n) a straight line of the tool, the base at rest.

        Raises:
            RoutineError: the arm does not reach, a joint would jump, or bodies come too near.
        """
        assert self._frame is not None  # the job was checked
        start = self._frame.place(self._robot.forward(q))
        here, there = (
            np.array([place.x_m, place.y_m, place.z_m, place.turn_rad]) for place in (start, target)
        )
        pieces = np.ceil(max(np.linalg.norm((there - here)[:3]) / LINE_M, abs((there - here)[3]) / TURN_RAD))
        path, exact = [q], self._exact(touching)
        for share in np.linspace(0.0, 1.0, max(1, int(pieces)) + 1)[1:]:
            place = ToolPlace(*(here + share * (there - here)).tolist())
            path.append(self._tracked(self._frame.pose(place), path[-1]))
            if not exact.keeps(path[-1][None]) and exact.measure(path[-1]).room_m < exact.measure(q).room_m:
                near = exact.measure(path[-1])
                raise RoutineError(
                    f"move_tool: {near.pair[0]} would be {near.distance_m:.3f} m from {near.pair[1]}, "
                    f"nearer than the stop distance, {near.distance_m - near.room_m:.3f} m"
                )
        return np.array(path)

    def _tracked(self, pose: Array, q: Array) -> Array:
        reached: Array = self._tracker.track(q[None, self._tracker.base], pose[None], q)[0]
        if not np.isfinite(reached).all():
            x, y, z = pose[:3, 3]
            raise RoutineError(
                f"move_tool: the arm of {self._robot.name} does not reach ({x:.3f}, {y:.3f}, {z:.3f}) m, "
                "or a joint would pass its limit"
            )
        if (jump := np.abs(reached - q).max()) > LEAP * TURN_RAD:
            raise RoutineError(f"move_tool: a joint would jump by {jump:.2f} rad")
        return reached

    def _exact(self, touching: bool) -> ExactClearance:
        return self._free if touching else self._clear

    def _motion(self, path: Array, speed: float, touching: bool) -> PlannedMotion:
        tightest = self._exact(touching).tightest(path)
        answered = Answered(self._tracker, Progress("", 1.0, 0.0, 0, (Option.along(path, tightest),)))
        pace = (min(speed, self._contact_speed) if touching else speed) / SHARE
        modes = {
            DrivingMode.ADVISOR: lambda robot: AdvisorMode(robot, self._cycle_s, answered, pace),
        }
        driver = Teleoperator(self._robot, self._cycle_s, DrivingMode.ADVISOR, modes=modes)
        setpoints = timed(path, self._tracker, self._cycle_s, hands_move=True)
        first = pace * (setpoints[min(1, len(setpoints) - 1)] - setpoints[0])
        return PlannedMotion(path, tightest, len(setpoints) * self._cycle_s / pace, first, driver)


def unreachable(cell: CellModel) -> dict[str, str]:
    """By name the items of equipment that a shipped routine cannot work on, and why, the other robots at home."""
    routines = {name: load_routine(name)[1] for name in shipped()}
    found: dict[str, str] = {}
    for name, item in cell.description.equipment.items():
        fitting = [
            each
            for each, routine in routines.items()
            if item.kind in routine.kinds and (item.tool or not any(step.tool for step in routine.steps))
        ]
        if item.approach is None or not fitting:
            continue
        longest = max(fitting, key=lambda each: len(routines[each].steps))
        try:
            job = job_for(cell.description, longest, name)
            tools = {job.robot: "" if item.kind == "tool_stand" else item.tool}
            RoutinePlanner(with_present_tools(cell, job, tools), job).check()
        except RoutineError as error:
            found[name] = f"{longest}: {error}"
    return found
