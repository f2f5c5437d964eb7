"""Obstacles of a `deltaq.Gate`: primitives and meshes, each with its pose in the world.

Box((1.2, 0.8, 0.05), at=(0.5, 0, -0.03))
Cylinder(radius_m=0.03, length_m=0.14, at=(0.4, 0.1, 0.07))
Mesh("shelf.stl", at=(0.6, 0, 0), rpy=(0, 0, 1.57))
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError

MOST_M = 1000.0
"""Greatest size and greatest coordinate of an obstacle [m]."""

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


class GateError(DeltaqError):
    """An input that a gate does not take; nothing has changed.

    Attributes:
        field: the parameter that is wrong, such as `dq` or `obstacles.table.at`.
        value: the given value.
        bound: the allowed value.
        remedy: what the caller can do.
    """

    def __init__(self, field: str, value: object, bound: str, remedy: str) -> None:
        super().__init__(f"{field}: {bound}, got {_shown(value)}; {remedy}")
        self.field, self.value, self.bound, self.remedy = field, value, bound, remedy


def numbers(name: str, value: ArrayLike, count: int, remedy: str, most: float = MOST_M) -> Array:
    """`value` as (count,) finite numbers of at most `most` [its own unit].

    Raises:
        GateError: it is not.
    """
    try:
        array = np.array(value)
        array = array.astype(np.float64, casting="same_kind" if array.dtype.kind == "c" else "unsafe")
    except (TypeError, ValueError):
        wanted = "a number" if count == 1 else f"{count} numbers"
        raise GateError(name, value, f"must be {wanted}", remedy) from None
    if array.shape != (count,):
        raise GateError(name, f"shape {array.shape}", f"must have shape ({count},)", remedy)
    if not np.isfinite(array).all() or np.abs(array).max(initial=0.0) > most:
        raise GateError(
            name, value, "must be finite" + ("" if np.isinf(most) else f" and at most {most:g}"), remedy
        )
    return array


def positive(name: str, value: float, most: float, remedy: str) -> float:
    """`value` if it is above 0 and at most `most`.

    Raises:
        GateError: it is not.
    """
    number = float(numbers(name, [value], 1, remedy, np.inf)[0])
    if not 0.0 < number <= most:
        raise GateError(name, value, f"must be above 0 and at most {most:g}", remedy)
    return number


@dataclass(frozen=True)
class Obstacle(ABC):
    """A body at rest in the world.

    Attributes:
        at: position of its frame [m].
        rpy: roll, pitch and yaw, `R = Rz(yaw) Ry(pitch) Rx(roll)` [rad].
    """

    at: Vector = field(default=ZERO, kw_only=True)
    rpy: Vector = field(default=ZERO, kw_only=True)

    def judge(self, name: str) -> None:
        """Raise a `GateError` if a number of this obstacle cannot be; `name` is the parameter's."""
        numbers(f"{name}.at", self.at, 3, "give x, y and z in m")
        numbers(f"{name}.rpy", self.rpy, 3, "give roll, pitch and yaw in rad")
        for size, value in self._sizes().items():
            positive(f"{name}.{size}", value, MOST_M, "give its size in m")

    @abstractmethod
    def shape(self) -> dict[str, Any]:
        """The shape as a cell's file describes it; empty for a mesh."""

    def _sizes(self) -> dict[str, float]:
        return {key: value for key, value in self.shape().items() if key != "kind"}


@dataclass(frozen=True)
class Box(Obstacle):
    """A box, its frame at its centre; `size_m` are its edges [m]."""

    size_m: Sequence[float]

    def judge(self, name: str) -> None:
        """See `Obstacle.judge`."""
        numbers(f"{name}.size_m", self.size_m, 3, "give three edges in m")
        super().judge(name)

    def shape(self) -> dict[str, Any]:
        """See `Obstacle.shape`."""
        return {"kind": "box", "size_m": tuple(map(float, self.size_m))}

    def _sizes(self) -> dict[str, float]:
        return {f"size_m[{index}]": size for index, size in enumerate(self.size_m)}


@dataclass(frozen=True)
class Sphere(Obstacle):
    """A ball of radius `radius_m` [m]."""

    radius_m: float

    def shape(self) -> dict[str, Any]:
        """See `Obstacle.shape`."""
        return {"kind": "sphere", "radius_m": self.radius_m}


@dataclass(frozen=True)
class Cylinder(Obstacle):
    """A cylinder along z, its frame at its centre [m]."""

    radius_m: float
    length_m: float

    def shape(self) -> dict[str, Any]:
        """See `Obstacle.shape`."""
        return {"kind": "cylinder", "radius_m": self.radius_m, "length_m": self.length_m}


@dataclass(frozen=True)
class Capsule(Cylinder):
    """A cylinder along z with round ends; `length_m` leaves the ends out [m]."""

    def shape(self) -> dict[str, Any]:
        """See `Obstacle.shape`."""
        return super().shape() | {"kind": "capsule"}


@dataclass(frozen=True, eq=False)
class Mesh(Obstacle):
    """A mesh, of which the gate takes the convex hull: split a concave one, such as a shelf, into convex parts.

    Attributes:
        mesh: a file that assimp reads (STL, OBJ, DAE), or (k, 3) points [m].
        scale: factor that gives metres, such as 0.001 for a file in millimetres.
    """

    mesh: str | Path | Array
    scale: float = 1.0

    def judge(self, name: str) -> None:
        """See `Obstacle.judge`."""
        super().judge(name)
        positive(f"{name}.scale", self.scale, MOST_M, "give a factor that gives metres")
        self.corners(name)

    def shape(self) -> dict[str, Any]:
        """See `Obstacle.shape`."""
        return {}

    def corners(self, name: str) -> tuple[Vector, ...]:
        """Corners of its hull [m].

        Raises:
            GateError: the mesh cannot be read, or its hull has no volume or is too large.
        """
        import coal

        from deltaq_cell.convex_parts import close_hull
        from deltaq_cell.hull import HullError

        remedy = "give a mesh with a volume, and a scale that gives metres"
        try:
            if isinstance(self.mesh, str | Path):
                if not Path(self.mesh).is_file():
                    raise GateError(f"{name}.mesh", str(self.mesh), "must be a file", "give its path")
                loaded = coal.MeshLoader().load(str(self.mesh), np.full(3, float(self.scale)))
                points = np.array(loaded.vertices())
            else:
                points = np.array(self.mesh, dtype=np.float64).reshape(-1, 3) * self.scale
            if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > MOST_M:
                raise GateError(f"{name}.mesh", "others", f"its points must be within {MOST_M:g} m", remedy)
            return close_hull(points)
        except (HullError, RuntimeError, TypeError, ValueError) as error:
            raise GateError(f"{name}.mesh", error, "must be a readable mesh with a volume", remedy) from None

    def digest(self) -> str:
        """A hash of hull and pose for the gate's fingerprint."""
        return hashlib.sha256(repr((self.corners("mesh"), self.at, self.rpy)).encode()).hexdigest()


def _shown(value: object) -> str:
    text = str(np.round(value, 6)) if isinstance(value, np.ndarray) else str(value)
    return text if len(text) <= 120 else f"{text[:117]}..."
