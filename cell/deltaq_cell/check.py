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

from deltaq_cell.cell_model import MOST_TOLD_BYTES, CellModel, LongDescriptionError
from deltaq_cell.description import CellDescription, RobotDescription, RsiDescription
from deltaq_cell.find import find_cell, resolve_near
from deltaq_cell.krc_files import judge_krc_files
from deltaq_cell.load import load_located
from deltaq_cell.models import RobotModelError, nearest_name
from deltaq_cell.never_checked import SAMPLES, Pair, Why, farthest_apart, ordered, samples
from deltaq_cell.open_realm import ALLOWS_ANYBODY, NEEDS_TOKENS, off_loopback
from deltaq_cell.problems import CellError, Problem
from deltaq_cell.proximity import ProximityEngine
from deltaq_cell.robot import RobotModel
from deltaq_cell.yaml_source import YamlNode, shown
from deltaq_protocol.errors import Severity

KRC_CYCLES_S = {"krc2": (0.012,), "krc4": (0.004, 0.012)}
"""Sample times of RSI by generation of the KRC."""

FieldPath = tuple[str | int, ...]


@dataclass(frozen=True)
class CheckReport:
    """What `check_cell` found.

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
    """Check a cell; see `Report`. No fault of the cell raises an exception."""
    try:
        path = find_cell(name_or_path)
        description, tree = load_located(path)
    except CellError as error:
        return CheckReport(str(name_or_path), error.problems, {})
    check = _Check(path, description, tree)
    problems = sorted(check.problems(), key=lambda problem: (problem.file, problem.line))
    return CheckReport(str(name_or_path), tuple(problems), check.never_checked)


class _Check:
    """The checks, each a generator of problems, over one cell."""

    def __init__(self, path: Path, description: CellDescription, tree: YamlNode) -> None:
        self.path = path
        self.cell = description
        self.tree = tree
        self.never_checked: dict[str, dict[Pair, Why]] = {}

    def problems(self) -> Iterator[Problem]:
        yield from self.ports()
        yield from self.open_realm()
        yield from self.timing()
        models: dict[str, RobotModel] = {}
        for name, robot in self.cell.robots.items():
            yield from self.references(name, robot)
            yield from self.cycle(name, robot)
            yield from self.krc_files(name, robot)
            try:
                model = RobotModel(robot, name)
                self.never_checked[name] = model.never_checked
                models[name] = model
            except RobotModelError as error:
                place = ("robots", name, *(int(part) if part.isdigit() else part for part in error.field))
                yield self.at(place, str(error), suggestion=error.suggestion)
                continue
            yield from self.limits(models[name])
            yield from self.tolerances(models[name])
        if len(models) == len(self.cell.robots):
            cell = CellModel.of(self.cell, models)
            yield from self.contacts(cell)
            yield from self.homes(cell)
            yield from self.told(cell)

    def at(
        self,
        field: FieldPath,
        message: str,
        value: object = None,
        bound: str | int | float | None = None,
        suggestion: str | None = None,
        severity: Severity = "error",
    ) -> Problem:
        """A problem at the place of a field."""
        node, _ = self.tree.find(field)
        name = ".".join(str(part) for part in field)
        return Problem(node.file, node.line, name, message, shown(value), bound, suggestion, severity)

    def ports(self) -> Iterator[Problem]:
        """No two listeners share a port."""
        taken: dict[int, str] = {}
        listeners: list[tuple[FieldPath, int]] = [
            (("hli",), _port(self.cell.hli)),
            (("sim",), _port(self.cell.sim)),
            (("tcp_port",), self.cell.tcp_port),
        ]
        for name, robot in self.cell.robots.items():
            listeners.append((("robots", name, "server"), _port(robot.server)))
            if isinstance(robot.driver, RsiDescription):
                listeners.append((("robots", name, "driver", "port"), robot.driver.port))
                if robot.driver.control_port is not None:
                    listeners.append((("robots", name, "driver", "control_port"), robot.driver.control_port))
        for field, port in listeners:
            if not 1 <= port <= 65535:
                yield self.at(field, f"port {port} does not exist; take one of 1 to 65535", port, 65535)
            elif port in taken:
                yield self.at(field, f"port {port} is that of {taken[port]} already; take another", port)
            else:
                taken[port] = ".".join(str(part) for part in field)

    def open_realm(self) -> Iterator[Problem]:
        """Nobody on another machine moves a robot without a token, unless the cell says so."""
        exposed = off_loopback(self.cell)
        if exposed is None or self.cell.clients_need_tokens:
            return
        field, value = exposed
        if self.cell.anyone_who_connects_may_move_the_robots:
            told = "anyone who reaches this address may move the robots, reset a stop and set outputs"
            yield self.at((field,), told, value, severity="warning")
            return
        told = (
            "other machines reach this address, and would need no token to move the robots; set "
            f"`{NEEDS_TOKENS}: true` and give the HLI the tokens, listen on 127.0.0.1, or set `{ALLOWS_ANYBODY}: true`"
        )
        yield self.at((field,), told, value)

    def timing(self) -> Iterator[Problem]:
        """No deadline of the gate is so short that a healthy cycle misses it."""
        least = 2 * self.cell.cycle_s
        for name in ("max_request_age_s", "gate_timeout_s", "hli_timeout_s", "krc_timeout_s"):
            value = getattr(self.cell.gate, name)
            if value < least:
                message = f"{value:g} s is less than two cycles; allow at least {least:g} s"
                yield self.at(("gate", name), message, value, least)

    def references(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """Bodies and files that a robot names exist."""
        structure = self.cell.structure
        for index, body in enumerate(robot.mounted_on):
            if body not in structure:
                allowed, near = ", ".join(structure) or "none", nearest_name(body, structure)
                message = f"no body '{body}' in the structure" + (f"; did you mean '{near}'?" if near else "")
                yield self.at(("robots", name, "mounted_on", index), message, body, allowed, near)
        if isinstance(robot.driver, RsiDescription):
            try:
                resolve_near(self.path, robot.driver.ethernet_xml)
            except FileNotFoundError as error:
                field = ("robots", name, "driver", "ethernet_xml")
                yield self.at(field, str(error), robot.driver.ethernet_xml)

    def cycle(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """The cell's cycle is a whole number of the KRC's."""
        if not isinstance(robot.driver, RsiDescription):
            return
        cycles = KRC_CYCLES_S[robot.driver.krc]
        multiples = [self.cell.cycle_s / cycle for cycle in cycles]
        if not any(math.isclose(m, round(m), abs_tol=1e-6) and round(m) >= 1 for m in multiples):
            allowed = " or ".join(f"{1000 * cycle:g} ms" for cycle in cycles)
            message = (
                f"{1000 * self.cell.cycle_s:g} ms is no multiple of the cycle of robots.{name}.driver.krc "
                f"'{robot.driver.krc}', which is {allowed}"
            )
            yield self.at(("cycle_s",), message, self.cell.cycle_s, cycles[0])

    def krc_files(self, name: str, robot: RobotDescription) -> Iterator[Problem]:
        """The KRC's files can be safe and agree with the cell."""
        try:
            found = judge_krc_files(self.path, robot)
        except FileNotFoundError:
            return  # reported as a reference that leads nowhere
        for finding in found:
            field = ("robots", name, "driver", *finding.field)
            yield self.at(field, str(finding), finding.value, finding.bound, severity=finding.severity)

    def limits(self, robot: RobotModel) -> Iterator[Problem]:
        """A joint's limits lie inside those of the robot's own data sheet, as its URDF has them."""
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
                    yield self.at(("robots", robot.name, "joints", name, field), message, given, allowed)

    def tolerances(self, robot: RobotModel) -> Iterator[Problem]:
        """No joint that is off by its tolerance moves the tool by more than the stop distance."""
        stop = self.cell.gate.stop_distance_m
        for index, (name, joint) in enumerate(robot.description.joints.items(), start=1):
            lever = _lever(robot, index) if joint.revolute else 1.0
            if joint.tracking_tolerance * lever > stop:
                field = "tracking_tolerance_deg" if joint.revolute else "tracking_tolerance_m"
                factor = math.degrees(1.0) if joint.revolute else 1.0
                value, bound = joint.tracking_tolerance * factor, round(stop / lever * factor, 3)
                message = (
                    f"{value:g} lets this joint alone carry the tool {joint.tracking_tolerance * lever:.3f} m off its "
                    f"path, more than the stop distance of {stop:g} m; at most {bound:g} is sound"
                )
                place = ("robots", robot.name, "joints", name, field)
                yield self.at(place, message, value, bound, severity="warning")

    def contacts(self, cell: CellModel) -> Iterator[Problem]:
        """Bodies that contacts name exist, and those that touch are a robot's."""
        own = [body.name for robot in cell.robots.values() for body in robot.geometry.geometryObjects]
        known = [*own, *(body.name for body in cell.structure)]
        for name, contact in self.cell.contacts.items():
            for field, names, bodies in (
                ("bodies", contact.bodies, own),
                ("against", contact.against, known),
            ):
                for index, body in enumerate(names):
                    if body not in bodies:
                        yield self.at(
                            ("contacts", name, field, index),
                            f"no body is named {body!r}" + (" on a robot" if field == "bodies" else ""),
                            body,
                            suggestion=next(iter(difflib.get_close_matches(body, bodies, n=1)), None),
                        )

    def homes(self, cell: CellModel) -> Iterator[Problem]:
        """With every robot at home, no two bodies are nearer than their stop distance."""
        proximity = ProximityEngine(cell)
        for name, robot in cell.robots.items():
            proximity.place(name, robot.home, np.zeros(robot.n))
        groups = [(name, group) for name in cell.robots for group in proximity.alone[name]]
        for first, second in combinations(cell.robots, 2):
            groups += [(second, group) for group in proximity.between[first, second]]
        for name, group in groups:
            distance = round(proximity.least(group), 4)
            if distance < group.stop_distance_m:
                one, other = group.nearest().pair
                remedy = _remedy(cell.robots[name], ordered(one, other), group.stop_distance_m)
                message = (
                    f"at home {one} and {other} are {distance:g} m apart, nearer than the stop distance of "
                    f"{group.stop_distance_m:g} m; {remedy}"
                )
                yield self.at(("robots", name, "joints"), message, distance, group.stop_distance_m)

    def told(self, cell: CellModel) -> Iterator[Problem]:
        """The description is not too long to be sent to clients."""
        try:
            cell.description_message()
        except LongDescriptionError as error:
            yield self.at(("robots",), str(error), bound=MOST_TOLD_BYTES)


def _remedy(robot: RobotModel, pair: Pair, stop_m: float) -> str:
    """What to do about two bodies that are too near at home."""
    if not all(name.startswith(f"{robot.name}/") for name in pair):
        return "choose another home, or name what the robot stands on in mounted_on"
    drawn = samples(robot.lower, robot.upper)
    farthest = farthest_apart(robot.model, list(robot.geometry.geometryObjects), [pair], drawn, stop_m)[pair]
    if farthest > stop_m:
        return "choose another home"
    return (
        f"in none of {SAMPLES} configurations within the joint limits are they farther apart than {farthest:.3f} m: "
        "lower gate.self_stop_distance_m, or, if they cannot touch, name them in never_checked"
    )


def _lever(robot: RobotModel, joint: int) -> float:
    """Largest distance of a hand from the axis of a joint that carries it [m], joints counted from 1."""
    levers = [0.0]
    for hand in robot.hands:
        frame = robot.model.frames[robot.frame_of(hand)]
        chain = [other for other in robot.model.supports[frame.parentJoint] if other > joint]
        if joint in robot.model.supports[frame.parentJoint]:
            links = [np.linalg.norm(robot.model.jointPlacements[other].translation) for other in chain]
            levers.append(float(sum(links) + np.linalg.norm(frame.placement.translation)))
    return max(levers)


def _port(endpoint: str) -> int:
    """Its port, also one that does not exist, which `Endpoint` refuses: the problem names it and its bound."""
    return int(endpoint.rsplit(":", 1)[1])
