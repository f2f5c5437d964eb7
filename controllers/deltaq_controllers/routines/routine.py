"""Routines as data: YAML files of steps, checked, and resolved for one item of equipment.

A number of a step is a number, a name, or `NUMBER * NAME`. Names are the routine's parameters, the numeric fields of
the equipment (`reach_m`, `stroke_m`, `turns`), and in a repeated step `direction`, the sign of what it is repeated by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from deltaq_cell.description import CellDescription, EquipmentDescription, EquipmentKind
from deltaq_cell.load import load_as
from deltaq_cell.models import nearest_name
from deltaq_cell.problems import CellError
from deltaq_cell.roles import RoleError, camera_roles
from deltaq_controllers.interface import ControllerError
from deltaq_protocol.messages import Sight

SHIPPED = Path(__file__).parent
"""Folder of the routines that come with deltaq."""
MOST_STEPS = 1000
"""Steps of a routine, repetitions included."""

Number = FiniteFloat | str
"""A number, or how it is made of one."""


class RoutineError(ControllerError):
    """A routine that is not well formed, cannot be done on that item of equipment, or did not end as it should.

    Attributes:
        report: of the run; empty if there was none.
    """

    def __init__(self, message: str, report: dict[str, Any] | None = None) -> None:
        super().__init__(message)
        self.report = report or {}


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RoutineParameter(_Part):
    """A number that the caller may give."""

    default: FiniteFloat
    least: FiniteFloat
    most: FiniteFloat
    whole: bool = False
    text: str = ""


class ToolMove(_Part):
    """A straight motion of the tool in the axes of the approach pose; what is left out stays as it is.

    `turn_deg` is about the equipment's axis, `by_m` a displacement along z from the present place.
    """

    x_m: Number | None = None
    y_m: Number | None = None
    z_m: Number | None = None
    turn_deg: Number | None = None
    by_m: Number | None = None


class Condition(_Part):
    """Holds when all that is named does, for `for_s` without a break."""

    sight: Sight | None = None
    """How well the camera sees what it was told to look at."""
    inputs: dict[str, bool] = {}
    """Digital inputs of the robot."""
    drive_lag: Annotated[float, Field(gt=0, lt=1)] | None = None
    """A drive is behind its setpoints by this share of the joint's tracking tolerance: the tool is at an end stop."""
    for_s: Number = 0.0


class Step(_Part):
    """One step: exactly one of the first eight fields."""

    move_to: Literal["approach", "home"] | tuple[FiniteFloat, ...] | None = None
    """A pose in front of the equipment, the robot's home, or a configuration [rad or m]; planned around bodies."""
    move_tool: ToolMove | None = None
    io: dict[str, bool] | None = None
    contact: Literal["allow", "forbid"] | None = None
    """The contact that the equipment names."""
    tool: Literal["open", "couple", "release"] | None = None
    """The tool changer: open it without a tool, couple the tool that the equipment names, or release that tool."""
    look: Literal["equipment", "tool"] | None = None
    """What the camera that follows looks at from now on."""
    wait_for: Condition | None = None
    repeat: Number | None = None
    """How often the steps below it are done; a negative number is a number of times in the other direction."""
    steps: tuple[Step, ...] = ()
    until: Condition | None = None
    """Of a motion: it ends early when this holds, and so does the repetition around it."""
    speed: Annotated[float, Field(gt=0, le=0.6)] = 0.3
    """Of a motion: share of the joints' greatest speeds; a contact has its own."""
    within_s: Annotated[float, Field(gt=0, le=3600, allow_inf_nan=False)] = 120.0
    """Time limit."""

    @property
    def kind(self) -> str:
        """Name of the field that says what it does."""
        return next(name for name in _KINDS if getattr(self, name) is not None)

    @model_validator(mode="after")
    def _does_one_thing(self) -> Self:
        given = [name for name in _KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"a step does one of {', '.join(_KINDS)}; this one {' and '.join(given) or 'none'}"
            )
        if (self.repeat is None) != (not self.steps):
            raise ValueError("repeat and steps belong together")
        if self.until is not None and not self.kind.startswith("move"):
            raise ValueError(f"until is for motions, not for {self.kind}")
        return self


_KINDS = ("move_to", "move_tool", "io", "contact", "tool", "look", "wait_for", "repeat")


class Routine(_Part):
    """A routine, as its file says it."""

    title: str
    kinds: tuple[EquipmentKind, ...]
    """Kinds of equipment that it works on; none: it needs no equipment."""
    parameters: dict[str, RoutineParameter] = {}
    steps: Annotated[tuple[Step, ...], Field(min_length=1)]
    abort: tuple[Step, ...] = ()
    """What brings the robot to a safe pose if the routine is given up."""


def load_routine(name_or_path: str | Path) -> tuple[str, Routine]:
    """A shipped routine by name, or one in a YAML file; its name and what it says.

    Raises:
        RoutineError: there is none, or the file has errors; each has its file, line and field.
    """
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml"):
        names = shipped()
        if str(name_or_path) not in names:
            near = nearest_name(str(name_or_path), names)
            raise RoutineError(
                f"no routine {str(name_or_path)!r}; there are {', '.join(names)}, or give a YAML file"
                + (f"; did you mean '{near}'?" if near else "")
            )
        path = SHIPPED / f"{name_or_path}.yaml"
    try:
        return path.stem, load_as(Routine, path)
    except CellError as error:
        raise RoutineError(str(error)) from None


def shipped() -> tuple[str, ...]:
    """Names of the routines that come with deltaq."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.yaml")))


@cache
def by_kind(changes_tools: bool) -> dict[str, tuple[str, ...]]:
    """Names of the shipped routines by the kind of equipment that they are for; those that need none under no name.

    Args:
        changes_tools: whether the robot can; if not, routines that do are left out.
    """
    found: dict[str, tuple[str, ...]] = {}
    for name in shipped():
        routine = load_routine(name)[1]
        if not changes_tools and any(step.tool for step in routine.steps):
            continue
        for kind in routine.kinds or ("",):
            found[kind] = (*found.get(kind, ()), name)
    return found


@dataclass(frozen=True)
class PlainStep:
    """One step with its numbers, after repetition.

    Attributes:
        step: what it does; its numbers are numbers.
        round: which repetition it belongs to, from 1; 0 outside of any.
    """

    step: Step
    round: int = 0

    @property
    def text(self) -> str:
        """What it does, in a few words."""
        given = getattr(self.step, self.step.kind)
        if isinstance(given, BaseModel):
            given = given.model_dump(exclude_defaults=True, mode="json")
        if isinstance(given, Mapping):
            given = ", ".join(f"{name} {_word(value)}" for name, value in given.items())
        elif isinstance(given, tuple):
            given = "a configuration"
        return f"{self.step.kind} {given}"


def _word(value: object) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_word(each)}" for name, each in value.items())
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Job:
    """A routine for one item of equipment, ready to be run.

    Attributes:
        routine: its name.
        robot: name of the robot that does it.
        camera: name of the robot whose camera looks; None without one.
        equipment: name of the item; empty for a routine without.
        item: its description.
        numbers: the parameters.
        steps: one after the other.
        abort: what brings the robot to a safe pose.
    """

    routine: str
    robot: str
    camera: str | None
    equipment: str
    item: EquipmentDescription | None
    numbers: dict[str, float]
    steps: tuple[PlainStep, ...]
    abort: tuple[PlainStep, ...]


def job_for(
    cell: CellDescription,
    name_or_path: str | Path,
    equipment: str = "",
    robot: str = "",
    **given: float,
) -> Job:
    """A routine with its numbers for an item of a cell.

    Args:
        cell: its description.
        name_or_path: the routine.
        equipment: name of the item; empty if the routine needs none.
        robot: name of the robot; empty for the one that the item names, or that the camera watches.
        given: parameters of the routine.

    Raises:
        RoutineError: there is no such routine, item, robot, parameter, output, input or contact, the item is of
            another kind, or a number is out of its bounds.
    """
    name, routine = load_routine(name_or_path)
    item = _item(cell, name, routine, equipment)
    robot, camera = _robots(cell, item, robot)
    numbers = _numbers(name, routine, item, given)
    known = dict(numbers)
    if item is not None:
        known |= {
            field: float(value)
            for field in ("reach_m", "stroke_m", "turns", "view_m")
            if (value := getattr(item, field)) is not None
        }
    steps, abort = (
        tuple(islice(_plain(name, each, known), MOST_STEPS + 1)) for each in (routine.steps, routine.abort)
    )
    if max(len(steps), len(abort)) > MOST_STEPS:
        raise RoutineError(f"{name}: more than {MOST_STEPS} steps, repetitions included")
    _check_steps(cell, name, robot, camera, item, (*steps, *abort))
    return Job(name, robot, camera, equipment, item, numbers, steps, abort)


def _item(cell: CellDescription, name: str, routine: Routine, equipment: str) -> EquipmentDescription | None:
    fitting = [each for each, item in cell.equipment.items() if item.kind in routine.kinds]
    if not routine.kinds:
        if equipment:
            raise RoutineError(f"{name} is done without equipment; leave out {equipment!r}")
        return None
    if equipment not in cell.equipment:
        near = nearest_name(equipment, cell.equipment)
        raise RoutineError(
            f"no equipment {equipment!r} in cell {cell.cell}; for {name} it has {', '.join(fitting) or 'none'}"
            + (f"; did you mean '{near}'?" if near else "")
        )
    item = cell.equipment[equipment]
    if item.kind not in routine.kinds:
        raise RoutineError(
            f"{name} is for {' or '.join(routine.kinds)}, and {equipment} is a {item.kind}; "
            f"cell {cell.cell} has {', '.join(fitting) or 'none'} for it"
        )
    return item


def _robots(cell: CellDescription, item: EquipmentDescription | None, robot: str) -> tuple[str, str | None]:
    """The robot that works, and the one whose camera looks."""
    named = robot or (item.robot if item is not None and item.robot else "")
    if named and named not in cell.robots:
        raise RoutineError(f"no robot {named!r} in cell {cell.cell}; it has {', '.join(cell.robots)}")
    try:
        roles = camera_roles(cell, leader=named or None)
    except RoleError:
        return named or next(iter(cell.robots)), None
    return roles.leader, roles.follower


def _numbers(
    name: str, routine: Routine, item: EquipmentDescription | None, given: Mapping[str, float]
) -> dict[str, float]:
    numbers = {each: parameter.default for each, parameter in routine.parameters.items()}
    for each, value in given.items():
        if each not in numbers:
            near = nearest_name(each, numbers)
            raise RoutineError(
                f"{name} has no parameter {each!r}; it has {', '.join(numbers) or 'none'}"
                + (f"; did you mean '{near}'?" if near else "")
            )
        bound = routine.parameters[each]
        if not (isinstance(value, int | float) and bound.least <= value <= bound.most):  # NaN is in no range
            raise RoutineError(f"{each}: {value!r} is not from {bound.least:g} to {bound.most:g}")
        if bound.whole and value != round(value):
            raise RoutineError(f"{each}: {value:g} is no whole number")
        numbers[each] = float(value)
    quarter_turns, turns = numbers.get("quarter_turns"), item.turns if item is not None else None
    if quarter_turns is not None and turns is not None and abs(quarter_turns) > 4 * turns:
        raise RoutineError(
            f"quarter_turns: {quarter_turns:g} is more than the valve has, {4 * turns:g} ({turns:g} turns)"
        )
    return numbers


def _plain(name: str, steps: tuple[Step, ...], known: Mapping[str, float]) -> Iterator[PlainStep]:
    """The steps with their numbers, repetitions laid out."""
    for step in steps:
        if step.repeat is not None:
            times = _number(name, step.repeat, known)
            inner = dict(known) | {"direction": math.copysign(1.0, times)}
            if abs(times) > MOST_STEPS:
                raise RoutineError(f"{name}: repeat {times:g} is not from -{MOST_STEPS} to {MOST_STEPS}")
            for count in range(1, round(abs(times)) + 1):
                yield from (PlainStep(each.step, count) for each in _plain(name, step.steps, inner))
            continue
        changed: dict[str, Any] = {}
        if step.move_tool is not None:
            fields = step.move_tool.model_dump(exclude_none=True)
            changed["move_tool"] = ToolMove(
                **{field: _number(name, value, known) for field, value in fields.items()}
            )
        for field in ("wait_for", "until"):
            condition: Condition | None = getattr(step, field)
            if condition is not None:
                for_s = _number(name, condition.for_s, known)
                changed[field] = condition.model_copy(update={"for_s": for_s})
        yield PlainStep(step.model_copy(update=changed))


def _number(name: str, given: Number, known: Mapping[str, float]) -> float:
    if isinstance(given, int | float):
        return float(given)
    factor, star, word = given.rpartition("*")
    try:
        times = float(factor) if star else 1.0
    except ValueError:
        times = math.nan
    value = times * known.get(word.strip(), math.nan)
    if not math.isfinite(value):
        names = ", ".join(known) or "none"
        raise RoutineError(f"{name}: {given!r} is no number, nor NUMBER * NAME with one of {names}")
    return value


def _check_steps(
    cell: CellDescription,
    name: str,
    robot: str,
    camera: str | None,
    item: EquipmentDescription | None,
    steps: tuple[PlainStep, ...],
) -> None:
    """Check that the robot and the item have what the steps name.

    Raises:
        RoutineError: naming what is missing.
    """
    described = cell.robots[robot]
    for plain in steps:
        step = plain.step
        at_item = step.move_tool is not None or step.move_to == "approach"
        if at_item and (item is None or item.approach is None):
            raise RoutineError(f"{name}: {plain.text}: the equipment has no approach pose")
        if step.move_tool is not None and step.move_tool.turn_deg and (item is None or item.axis is None):
            raise RoutineError(f"{name}: {plain.text}: the equipment has no axis")
        if step.contact is not None and (item is None or item.contact is None):
            raise RoutineError(f"{name}: {plain.text}: the equipment names no contact")
        if step.tool is not None and (item is None or item.tool not in described.tools):
            raise RoutineError(f"{name}: {plain.text}: the equipment names no tool of {robot}")
        if step.look == "equipment" and item is None:
            raise RoutineError(f"{name}: {plain.text}: there is no equipment to look at")
        if isinstance(step.move_to, tuple):
            _check_configuration(name, robot, cell, step.move_to)
        conditions = [each for each in (step.wait_for, step.until) if each is not None]
        if camera is None and any(each.sight is not None for each in conditions):
            raise RoutineError(f"{name}: {plain.text}: no robot of cell {cell.cell} has a camera")
        inputs = [each for condition in conditions for each in condition.inputs]
        for kind, names, known in (
            ("output", list(step.io or ()), described.outputs),
            ("input", inputs, described.inputs),
        ):
            for each in names:
                if each not in known:
                    raise RoutineError(
                        f"{name}: {robot} has no {kind} {each!r}; it has {', '.join(known) or 'none'}"
                    )


def _check_configuration(name: str, robot: str, cell: CellDescription, q: tuple[float, ...]) -> None:
    described = cell.robots[robot]
    if len(q) != len(described.joint_names):
        raise RoutineError(
            f"{name}: move_to: {robot} has {len(described.joint_names)} joints, got {len(q)} elements"
        )
    for joint, value, lower, upper in zip(
        described.joint_names, q, described.lower, described.upper, strict=True
    ):
        if not lower <= value <= upper:
            raise RoutineError(f"{name}: move_to: {joint} at {value:g} is not from {lower:g} to {upper:g}")
