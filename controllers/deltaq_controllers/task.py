"""A task as data, for the advisor and the mode `coupled` alike: what the hands have to do, and what is free.

Hooper and Noakes, III and IV: both need to be told about the task. A hand that need not keep an axis, as a peg needs no
roll, gives the robot one more dimension of self-motion. A tolerance is modelled as a joint without a drive between the
hand and the place where it is to be, its limits those of the tolerance: all that knows joints and limits knows it, too.
"""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, model_validator

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import JointDescription, RobotDescription
from deltaq_cell.load import load_as
from deltaq_cell.models import nearest_name
from deltaq_cell.robot import RobotModel
from deltaq_controllers.interface import ControllerError
from deltaq_protocol.arrays import Array, Flags

SHIPPED = Path(__file__).parent / "tasks"
"""Folder of the tasks that come with deltaq."""

AXES = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")
"""The axes of a hand: along its own axes, and about them."""

WIDE_DEG = 80.0
"""Only one turn of a hand may be wider: two such have no unique angles."""

SWIFT = 1000.0
"""Greatest speed and acceleration of a tolerance, which has no drive: no drive is as quick [m/s, rad/s and per s]."""

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class TaskError(ControllerError):
    """A task that is not well formed, or does not fit the cell, its robot or where the hands are."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


_Slide = Annotated[FiniteFloat, Field(ge=0, le=1)]
_Turn = Annotated[
    FiniteFloat, Field(ge=0, le=180), BeforeValidator(lambda given: 180.0 if given == "free" else given)
]


class Tolerance(_Part):
    """How far a hand may be off its pose either way, by its own axes; `free` is the whole turn."""

    x_m: _Slide = 0.0
    y_m: _Slide = 0.0
    z_m: _Slide = 0.0
    rx_deg: _Turn = 0.0
    ry_deg: _Turn = 0.0
    rz_deg: _Turn = 0.0

    @model_validator(mode="after")
    def _has_one_wide_turn(self) -> Self:
        wide = [axis for axis in AXES[3:] if getattr(self, axis) > WIDE_DEG]
        if len(wide) > 1:
            raise ValueError(f"only one turn may be wider than {WIDE_DEG:g} deg; {' and '.join(wide)} are")
        return self

    def axes(self) -> list[str]:
        """The axes with a tolerance: slides first, then turns in cyclic order from the widest on."""
        turns = [getattr(self, axis) for axis in AXES[3:]]
        first = turns.index(max(turns))
        ordered = [*AXES[:3], *AXES[3 + first :], *AXES[3 : 3 + first]]
        return [axis for axis in ordered if getattr(self, axis) > 0.0]


class Region(_Part):
    """A box along the axes of the world that the hand's origin stays in [m]."""

    lower_m: Vector
    upper_m: Vector

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        for axis, lower, upper in zip("xyz", self.lower_m, self.upper_m, strict=True):
            if lower >= upper:
                raise ValueError(f"{axis}: lower_m {lower:g} must be below upper_m {upper:g}")
        return self

    def holds(self, places: Array) -> Flags:
        """(...) whether places (..., 3) in the world are inside [m]."""
        inside: Flags = np.all((places >= self.lower_m) & (places <= self.upper_m), axis=-1)
        return inside


class HandTask(_Part):
    """What one hand has to do. Vectors are in the hand's axes."""

    tolerance: Tolerance = Tolerance()
    force_n: Vector | None = None
    """Force that the hand exerts: joints carry it (`torque`), along it `force` and `deformation` are judged."""
    motion: Vector | None = None
    """Direction in which it works: along it `speed` and `acceleration` are judged."""
    region: Region | None = None

    @model_validator(mode="after")
    def _has_directions(self) -> Self:
        for field in ("force_n", "motion"):
            if getattr(self, field) is not None and not any(getattr(self, field)):
                raise ValueError(f"{field} must have a length above 0, got {list(getattr(self, field))}")
        return self


class Task(_Part):
    """A task, as its file says it."""

    title: str = ""
    robot: str = ""
    """Robot that does it; empty for the one that the command names."""
    hands: dict[str, HandTask] = {}
    """By the hand's name; of a robot with one, `tool`. Other hands keep their poses."""
    weights: dict[str, Annotated[FiniteFloat, Field(ge=0)]] | None = None
    """Of the criteria, in place of the default ones."""
    known: tuple[str, ...] | None = None
    """Bodies of the cell's structure whose place is known; others are left to the gate. By default all are."""
    dwell_s: Annotated[FiniteFloat, Field(ge=0, le=3600)] = 0.0
    """Time for which the hands have to be still; `coupled` counts it."""

    @model_validator(mode="after")
    def _weighs_something(self) -> Self:
        if self.weights is not None and not any(self.weights.values()):
            raise ValueError(f"weights: one at least must be above 0, got {self.weights or 'none'}")
        return self

    def seen(self, cell: CellModel) -> CellModel:
        """The cell with the bodies that the task knows; for advice, never for the gate.

        Raises:
            TaskError: the cell has no such body, or no such robot.
        """
        _check("robot", (self.robot,) if self.robot else (), cell.robots)
        if self.known is None:
            return cell
        structure = cell.description.structure
        _check("known", self.known, structure)
        left = {name: body for name, body in structure.items() if name in self.known}
        return CellModel.of(cell.description.model_copy(update={"structure": left}), cell.robots, cell.yaml)

    def check_hands(self, robot: RobotModel) -> None:
        """Check that the robot has the hands that the task names.

        Raises:
            TaskError: it has not.
        """
        _check("hands", self.hands, robot.hands)

    def check_region(self, hands: Iterable[str], T_world_hands: Array) -> None:
        """Check that hands are in their regions.

        Args:
            hands: their names.
            T_world_hands: (h, 4, 4) their poses.

        Raises:
            TaskError: one is not.
        """
        for hand, T in zip(hands, T_world_hands, strict=True):
            region = self.region(hand)
            if region is not None and not region.holds(T[:3, 3]):
                axis = int(np.argmax(np.maximum(region.lower_m - T[:3, 3], T[:3, 3] - region.upper_m)))
                raise TaskError(
                    f"hands.{hand}.region: the hand is outside: {'xyz'[axis]} is {T[axis, 3]:.3f} m, not from "
                    f"{region.lower_m[axis]:g} to {region.upper_m[axis]:g} m"
                )

    def region(self, hand: str) -> Region | None:
        """The region of a hand; None without one."""
        return self.hands[hand].region if hand in self.hands else None

    def vectors(self, field: Literal["force_n", "motion"], hands: Iterable[str]) -> Array:
        """(h, 3) forces [N] or directions of motion of hands, in their axes; zero of those without."""
        given = (getattr(self.hands[hand], field) if hand in self.hands else None for hand in hands)
        vectors: Array = np.array([vector or (0.0, 0.0, 0.0) for vector in given])
        return vectors

    def tolerances(self) -> Iterator[tuple[str, str, float]]:
        """Of each axis with a tolerance: hand, axis, and how far it may be off [m or deg]."""
        for hand, needs in self.hands.items():
            for axis in needs.tolerance.axes():
                yield hand, axis, getattr(needs.tolerance, axis)


def _check(field: str, given: Iterable[str], known: Iterable[str]) -> None:
    for name in given:
        if name not in (names := tuple(known)):
            near = nearest_name(name, names)
            meant = f"; did you mean '{near}'?" if near else ""
            raise TaskError(f"{field}: no {name!r} here; there are {', '.join(names) or 'none'}{meant}")


NO_TASK = Task()
"""Every hand keeps its pose, and the criteria are the default ones."""


def load_task(name_or_path: str | Path) -> Task:
    """A shipped task by name, or one in a YAML file.

    Raises:
        TaskError: none of that name comes with deltaq.
        CellError: the file cannot be read or has errors; each has its file, line, field, value and bound.
    """
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml"):
        return load_as(Task, path)
    _check("task", (str(path),), (*shipped(), "a YAML file"))
    return load_as(Task, SHIPPED / f"{path}.yaml")


def shipped() -> tuple[str, ...]:
    """Names of the tasks that come with deltaq."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.yaml")))


class TolerantRobot(RobotModel):
    """A robot with a joint without a drive for each tolerance of a task, between a hand and where the hand is to be.

    These joints come after its own. At zero the hand has its pose exactly.

    Args:
        robot: the robot.
        task: names the tolerances.
    """

    def __init__(self, robot: RobotModel, task: Task) -> None:
        self.__dict__.update(robot.__dict__)
        self.__dict__.pop("revolute", None)
        self.model = pin.Model(robot.model)
        joints = dict(robot.description.joints)
        for hand, axis, off in task.tolerances():
            frame, kind = self.model.frames[robot.frame_of(hand)], _JOINTS[axis]
            name = f"{hand} tolerance {axis.split('_')[0]}"
            frame.parentJoint = self.model.addJoint(frame.parentJoint, kind, frame.placement, name)
            frame.placement = pin.SE3.Identity()
            joints[name] = _undriven(axis, off)
        # anew, since a copy would keep the old limits
        self.description = RobotDescription.model_construct(**dict(robot.description) | {"joints": joints})
        self._data = self.model.createData()


def tolerant(robot: RobotModel, task: Task) -> RobotModel:
    """The robot with the tolerances of a task as joints; itself if there are none.

    Raises:
        TaskError: the robot does not have a hand that the task names.
    """
    task.check_hands(robot)
    return TolerantRobot(robot, task) if any(task.tolerances()) else robot


_JOINTS = {
    "x_m": pin.JointModelPX(),
    "y_m": pin.JointModelPY(),
    "z_m": pin.JointModelPZ(),
    "rx_deg": pin.JointModelRX(),
    "ry_deg": pin.JointModelRY(),
    "rz_deg": pin.JointModelRZ(),
}


def _undriven(axis: str, off: float) -> JointDescription:
    if axis in AXES[:3]:
        return JointDescription(
            home_m=0.0, lower_m=-off, upper_m=off, max_velocity_m_s=SWIFT, max_acceleration_m_s2=SWIFT
        )
    swift = float(np.rad2deg(SWIFT))
    return JointDescription(
        home_deg=0.0,
        lower_deg=-off,
        upper_deg=off,
        max_velocity_deg_s=swift,
        max_acceleration_rad_s2=SWIFT,
    )


def tolerated(task: Task, hand: str, T_hand_place: Array) -> Array:
    """(k,) positions of the tolerances of a hand that have it at a place (4, 4), given in the frame of the hand.

    What the tolerances do not allow is left out.
    """
    axes = task.hands[hand].tolerance.axes() if hand in task.hands else []
    turns = [AXES[3:].index(axis) for axis in axes if axis in AXES[3:]]
    first = turns[0] if turns else 0
    order = [(first + k) % 3 for k in range(3)]
    R = T_hand_place[:3, :3][np.ix_(order, order)]  # as if its axes were x, y and z, and it Rx(a) Ry(b) Rz(c)
    angles = np.empty(3)
    angles[order] = (
        np.arctan2(-R[1, 2], R[2, 2]),
        np.arcsin(np.clip(R[0, 2], -1.0, 1.0)),
        np.arctan2(-R[0, 1], R[0, 0]),
    )
    return np.array([np.append(T_hand_place[:3, 3], angles)[AXES.index(axis)] for axis in axes])
