"""Check a cell description more deeply than its schema can: against its robots' models and against itself."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from deltaq_cell.cell_model import MOST_TOLD_BYTES, CellModel, LongDescriptionError
from deltaq_cell.check_description import DescriptionCheck
from deltaq_cell.description import CellDescription
from deltaq_cell.find import find_cell
from deltaq_cell.load import load_located
from deltaq_cell.models import RobotModelError
from deltaq_cell.never_checked import SAMPLES, Pair, Why, distances, ordered, overlaps_in_part, samples
from deltaq_cell.problems import CellError, Problem
from deltaq_cell.proximity import ProximityEngine
from deltaq_cell.robot import RobotModel
from deltaq_cell.yaml_tree import PlacedProblems


@dataclass(frozen=True)
class CheckReport:
    """The result of `check_cell`.

    Attributes:
        cell: the name or path that was checked.
        problems: errors and warnings, in the order of the file.
        never_checked: by robot, pairs of its bodies that are never checked, and why.
    """

    cell: str
    problems: tuple[Problem, ...]
    never_checked: dict[str, dict[Pair, Why]]

    @property
    def errors(self) -> tuple[Problem, ...]:
        """Problems that keep the cell from being used."""
        return tuple(problem for problem in self.problems if problem.severity == "error")

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Problems that do not keep the cell from being used."""
        return tuple(problem for problem in self.problems if problem.severity == "warning")

    @property
    def ok(self) -> bool:
        """True if there are no errors."""
        return not self.errors

    def as_dict(self) -> dict[str, Any]:
        """The report as a JSON object."""
        problems = [problem.as_dict() for problem in self.problems]
        left_out = {
            robot: [{"pair": list(pair), "why": why} for pair, why in pairs.items()]
            for robot, pairs in self.never_checked.items()
        }
        return {"cell": self.cell, "ok": self.ok, "problems": problems, "never_checked": left_out}


def check_cell(name_or_path: str | Path) -> CheckReport:
    """Check a cell; see `CheckReport`. No fault of the cell raises an exception."""
    try:
        path = find_cell(name_or_path)
        description, tree = load_located(path)
    except CellError as error:
        return CheckReport(str(name_or_path), error.problems, {})
    never_checked: dict[str, dict[Pair, Why]] = {}
    found = _problems(path, description, PlacedProblems(tree), never_checked)
    problems = sorted(found, key=lambda problem: (problem.file, problem.line))
    return CheckReport(str(name_or_path), tuple(problems), never_checked)


def _problems(
    path: Path, cell: CellDescription, placed: PlacedProblems, never_checked: dict[str, dict[Pair, Why]]
) -> Iterator[Problem]:
    """All problems; robots whose model is sound are put into `never_checked`."""
    described, modelled = DescriptionCheck(path, cell, placed), ModelCheck(cell, placed)
    yield from described.of_cell()
    models: dict[str, RobotModel] = {}
    for name, robot in cell.robots.items():
        yield from described.of_robot(name, robot)
        try:
            model = RobotModel(robot, name)
            never_checked[name] = model.never_checked  # the pairs that it names are looked for here
        except RobotModelError as error:
            place = ("robots", name, *(int(part) if part.isdigit() else part for part in error.field))
            yield placed.at(place, str(error), suggestion=error.suggestion)
            continue
        models[name] = model
        yield from modelled.of_robot(model)
    if len(models) == len(cell.robots):
        yield from modelled.of_cell(CellModel.of(cell, models))


# Problems of a cell description that show with the models of its robots, and with all bodies together.


class ModelCheck:
    """Checks, each a generator of problems.

    Args:
        cell: its description.
        placed: makes the problems.
    """

    def __init__(self, cell: CellDescription, placed: PlacedProblems) -> None:
        self._cell, self._at = cell, placed.at

    def of_robot(self, robot: RobotModel) -> Iterator[Problem]:
        """Problems of a robot's model."""
        yield from self._limits(robot)
        yield from self._tolerances(robot)
        yield from self._joined(robot)

    def of_cell(self, cell: CellModel) -> Iterator[Problem]:
        """Problems of the robots with one another and with the structure around them."""
        yield from self._contacts(cell)
        yield from self._homes(cell)
        yield from self._told(cell)

    def _limits(self, robot: RobotModel) -> Iterator[Problem]:
        """Check that a joint's limits lie inside those of its URDF."""
        for index, (name, joint) in enumerate(robot.description.joints.items()):
            unit, factor = ("deg", math.degrees(1.0)) if joint.revolute else ("m", 1.0)
            sheet = {
                f"lower_{unit}": (joint.lower, float(robot.model.lowerPositionLimit[index]), -1),
                f"upper_{unit}": (joint.upper, float(robot.model.upperPositionLimit[index]), 1),
                f"max_velocity_{unit}_s": (joint.max_velocity, float(robot.model.velocityLimit[index]), 1),
            }
            for field, (value, bound, sign) in sheet.items():
                if sign * (value - bound) > 1e-6:
                    word = "below" if sign < 0 else "above"
                    given, allowed = round(value * factor, 4), round(bound * factor, 4)
                    message = f"{given:g} is {word} what the robot's model allows, {allowed:g}"
                    yield self._at(("robots", robot.name, "joints", name, field), message, given, allowed)

    def _tolerances(self, robot: RobotModel) -> Iterator[Problem]:
        """No joint's tolerance alone makes the gate keep the tool twice as far away."""
        stop = self._cell.gate.stop_distance_m
        for index, (name, joint) in enumerate(robot.description.joints.items(), start=1):
            lever = _lever(robot, index) if joint.revolute else 1.0
            if joint.tracking_tolerance * lever > stop:
                field = "tracking_tolerance_deg" if joint.revolute else "tracking_tolerance_m"
                factor = math.degrees(1.0) if joint.revolute else 1.0
                value, bound = joint.tracking_tolerance * factor, round(stop / lever * factor, 3)
                message = (
                    f"{value:g} makes the gate keep the tool {joint.tracking_tolerance * lever:.3f} m further from "
                    f"everything, more than the stop distance of {stop:g} m; give at most {bound:g}"
                )
                place = ("robots", robot.name, "joints", name, field)
                yield self._at(place, message, value, bound, severity="warning")

    def _joined(self, robot: RobotModel) -> Iterator[Problem]:
        """Bodies that one joint joins are never checked, so that they overlap nowhere or, as a hinge, everywhere."""
        bodies = list(robot.geometry.geometryObjects)
        adjacent = [pair for pair, why in robot.never_checked.items() if why is Why.ADJACENT]
        for found in overlaps_in_part(robot.model, bodies, adjacent, robot.home, robot.lower, robot.upper):
            name = robot.joint_names[found.joint]
            unit, factor = ("deg", math.degrees(1.0)) if robot.revolute[found.joint] else ("m", 1.0)
            where = " and ".join(f"{low * factor:.4g} to {high * factor:.4g}" for low, high in found.ranges)
            message = (
                f"{' and '.join(found.pair)} overlap by up to {found.depth_m:.3f} m with this joint at {where} {unit}, "
                "and are apart elsewhere; bodies that one joint joins are never checked: narrow its limits, correct "
                "the bodies, or, if one slides into the other, name them in never_checked"
            )
            yield self._at(("robots", robot.name, "joints", name), message, severity="warning")

    def _contacts(self, cell: CellModel) -> Iterator[Problem]:
        """Check that the bodies of a contact exist, and that those in `bodies` belong to a robot."""
        own = [body.name for robot in cell.robots.values() for body in robot.geometry.geometryObjects]
        known = [*own, *(body.name for body in cell.structure)]
        for name, contact in self._cell.contacts.items():
            for field, names, bodies in (
                ("bodies", contact.bodies, own),
                ("against", contact.against, known),
            ):
                for index, body in enumerate(names):
                    if body not in bodies:
                        yield self._at(
                            ("contacts", name, field, index),
                            f"no body is named {body!r}" + (" on a robot" if field == "bodies" else ""),
                            body,
                            suggestion=next(iter(difflib.get_close_matches(body, bodies, n=1)), None),
                        )

    def _homes(self, cell: CellModel) -> Iterator[Problem]:
        """With every robot at home or off it by its tolerances, no two bodies are nearer than their stop distance."""
        proximity = ProximityEngine(cell)
        for name, robot in cell.robots.items():
            proximity.place(name, robot.home, robot.description.tracking_tolerance)
        groups = [(name, group) for name in cell.robots for group in proximity.alone[name]]
        for first, second in combinations(cell.robots, 2):
            groups += [(second, group) for group in proximity.between[first, second]]
        for name, group in groups:
            distance = round(proximity.least(group), 4)
            if distance < group.stop_distance_m:
                one, other = group.nearest().pair
                remedy = _remedy(cell.robots[name], ordered(one, other), group.stop_distance_m)
                message = (
                    f"at home {one} and {other} may be {distance:g} m apart, nearer than the stop distance of "
                    f"{group.stop_distance_m:g} m; {remedy}"
                )
                yield self._at(("robots", name, "joints"), message, distance, group.stop_distance_m)

    def _told(self, cell: CellModel) -> Iterator[Problem]:
        """Check that the description is short enough for messages to clients."""
        try:
            cell.description_message()
        except LongDescriptionError as error:
            yield self._at(("robots",), str(error), bound=MOST_TOLD_BYTES)
        except ValidationError as error:
            fault = error.errors()[0]
            where, told = ".".join(map(str, fault["loc"])), fault["msg"].removeprefix("Input ")
            yield self._at(
                ("robots",), f"no message can carry a robot's {where}, {fault['input']!r}: it {told}"
            )


def _remedy(robot: RobotModel, pair: Pair, stop_m: float) -> str:
    """The remedy for two bodies that are too near at home."""
    if not all(name.startswith(f"{robot.name}/") for name in pair):
        return "choose another home, or name what the robot stands on in mounted_on"
    drawn = samples(robot.lower, robot.upper)
    farthest = distances(robot.model, list(robot.geometry.geometryObjects), [pair], drawn).max()
    if farthest > stop_m:
        return "choose another home"
    return (
        f"in none of {SAMPLES} configurations within the joint limits are they farther apart than {farthest:.3f} m: "
        "lower gate.self_stop_distance_m, or, if they cannot touch, name them in never_checked"
    )


def _lever(robot: RobotModel, joint: int) -> float:
    """Largest distance of a hand from the axis of a joint that carries it [m], joints counted from 1."""
    levers = [0.0]
    for hand in (*robot.hands, *robot.tool_bodies):
        frame = robot.model.frames[robot.frame_of(hand)]
        chain = [other for other in robot.model.supports[frame.parentJoint] if other > joint]
        if joint in robot.model.supports[frame.parentJoint]:
            links = [np.linalg.norm(robot.model.jointPlacements[other].translation) for other in chain]
            levers.append(float(sum(links) + np.linalg.norm(frame.placement.translation)))
    return max(levers)
