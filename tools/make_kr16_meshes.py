"""Write the meshes of the KR 16: `python tools/make_kr16_meshes.py`.

Collision meshes are the convex hulls of the sections. Visual meshes are lofts through the same sections with
their edges rounded, so that nothing is drawn that is not checked; what is dark on the robot (motors, the
joints' caps) is a mesh of its own. The files are committed; running this again changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import coal
import numpy as np

from kr16_sections import LINK_4_RADIUS_M, SLABS, Range, corners

FOLDER = Path(__file__).parents[1] / "cell/deltaq_cell/robots/kr16/meshes"
Point = tuple[float, float, float]
_CORNER = 4
"""Points to a rounded corner."""
_AROUND = 24
"""Points to a circle."""


@dataclass
class Mesh:
    """A triangle mesh; faces count from 0 and turn counter-clockwise as seen from outside."""

    points: list[Point] = field(default_factory=list)
    faces: list[tuple[int, int, int]] = field(default_factory=list)

    def add_rings(self, rings: list[list[Point]]) -> Mesh:
        """Join rings of equally many points into a closed tube, its ends closed by fans."""
        start, around = len(self.points), len(rings[0])
        self.points += [point for ring in rings for point in ring]
        for k in range(len(rings) - 1):
            for i in range(around):
                a, b = start + k * around + i, start + k * around + (i + 1) % around
                self.faces += [(a, b, b + around), (a, b + around, a + around)]
        last = start + (len(rings) - 1) * around
        for i in range(1, around - 1):
            self.faces += [(start, start + i + 1, start + i), (last, last + i, last + i + 1)]
        return self

    def text(self, title: str) -> str:
        """The mesh as Wavefront OBJ."""
        lines = [f"# {title} [m]"]
        lines += [f"v {x:.4f} {y:.4f} {z:.4f}".replace("-0.0000", "0.0000") for x, y, z in self.points]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in self.faces]
        return "\n".join(lines) + "\n"


def _turn(axis: str, along: float, u: float, v: float) -> Point:
    """A point by its place along `axis` and in the plane across it; (u, v, axis) is right-handed."""
    return {"x": (along, u, v), "y": (v, along, u), "z": (u, v, along)}[axis]


def _rounded(axis: str, along: float, us: Range, vs: Range, radius: float) -> list[Point]:
    """A rectangle with round corners across `axis`."""
    radius = min(radius, (us[1] - us[0]) / 2.01, (vs[1] - vs[0]) / 2.01)
    ring = []
    for quarter, (u, v) in enumerate(
        [(us[1] - radius, vs[1] - radius), (us[0] + radius, vs[1] - radius),
         (us[0] + radius, vs[0] + radius), (us[1] - radius, vs[0] + radius)]
    ):  # fmt: skip
        for step in range(_CORNER):
            angle = math.pi / 2 * (quarter + step / (_CORNER - 1))
            ring.append(_turn(axis, along, u + radius * math.cos(angle), v + radius * math.sin(angle)))
    return ring


def _loft(
    axis: str, stations: list[tuple[float, Range, Range]], radius: float, bevel: float
) -> list[list[Point]]:
    """Rings through stations (place, u range, v range) along an axis; the two ends are bevelled."""
    rings = []
    for along, us, vs in stations:
        rings.append(_rounded(axis, along, us, vs, radius))
    for end, inward in ((0, bevel), (-1, -bevel)):
        along, us, vs = stations[end]
        small = _rounded(
            axis, along, (us[0] + bevel, us[1] - bevel), (vs[0] + bevel, vs[1] - bevel), radius - bevel / 2
        )
        moved = _rounded(axis, along + inward, us, vs, radius)
        if end == 0:
            rings[0:1] = [small, moved]
        else:
            rings[-1:] = [moved, small]
    return rings


def _cylinder(
    axis: str, centre: tuple[float, float], radius: float, span: Range, bevel: float = 0.006
) -> list[list[Point]]:
    """Rings of a cylinder about `axis` through `centre` (across it), its edges bevelled."""
    lo, hi = span
    rings = []
    for along, r in ((lo, radius - bevel), (lo + bevel, radius), (hi - bevel, radius), (hi, radius - bevel)):
        angles = [2 * math.pi * i / _AROUND for i in range(_AROUND)]
        rings.append(
            [_turn(axis, along, centre[0] + r * math.cos(a), centre[1] + r * math.sin(a)) for a in angles]
        )
    return rings


def _through_slabs(link: str, axis: str) -> list[tuple[float, Range, Range]]:
    """Stations for a loft: both ends, and the middle of each slab between."""
    k = "xyz".index(axis)
    slabs = SLABS[link]
    us, vs = [[slab[(k + 1) % 3] for slab in slabs], [slab[(k + 2) % 3] for slab in slabs]]
    stations = [(slabs[0][k][0], us[0], vs[0])]
    stations += [(sum(s[k]) / 2, u, v) for s, u, v in zip(slabs[1:-1], us[1:-1], vs[1:-1], strict=True)]
    return [*stations, (slabs[-1][k][1], us[-1], vs[-1])]


def _visuals() -> dict[str, Mesh]:
    body: dict[str, Iterable[list[list[Point]]]] = {
        "base": [_loft("z", _through_slabs("base", "z"), 0.09, 0.012)],
        "link_1": [_loft("z", _through_slabs("link_1", "z"), 0.10, 0.015)],
        "link_2": [
            _loft("x", [(0.02, (-0.235, -0.09), (-0.08, 0.08)), (0.25, (-0.255, -0.10), (-0.075, 0.075)),
                        (0.66, (-0.235, -0.09), (-0.065, 0.065))], 0.035, 0.01),
            _cylinder("y", (0.0, 0.005), 0.088, (-0.240, -0.083)),
            _cylinder("y", (0.0, 0.68), 0.080, (-0.245, -0.085)),
        ],
        "link_3": [
            _loft("x", [(-0.20, (-0.105, 0.19), (-0.16, 0.105)), (0.10, (-0.105, 0.19), (-0.15, 0.10)),
                        (0.23, (-0.095, 0.13), (-0.125, 0.07)), (0.33, (-0.07, 0.07), (-0.105, 0.04))], 0.06, 0.015),
            _cylinder("x", (0.0, -0.035), 0.074, (0.30, 0.403)),
        ],
        "link_4": [
            _cylinder("x", (0.0, 0.0), 0.068, (-0.266, -0.10)),
            _loft("x", [(-0.13, (-0.054, 0.062), (-0.058, 0.058)),
                        (0.06, (-0.048, 0.068), (-0.055, 0.055))], 0.03, 0.01),
        ],
        "link_5": [
            _cylinder("y", (0.0, 0.0), 0.056, (-0.092, 0.104)),
            _loft("x", [(-0.01, (-0.06, 0.07), (-0.05, 0.05)), (0.09, (-0.055, 0.06), (-0.05, 0.05))], 0.03, 0.01),
            _cylinder("x", (0.0, 0.0), 0.046, (0.07, 0.140)),
        ],
    }  # fmt: skip
    dark: dict[str, Iterable[list[list[Point]]]] = {
        "base": [_cylinder("z", (0.0, 0.0), 0.222, (0.36, 0.396))],
        "link_1": [
            _cylinder("z", (0.0, 0.0), 0.255, (-0.290, -0.255)),
            _cylinder("y", (0.0, 0.26), 0.095, (-0.10, -0.075)),
            _cylinder("y", (0.0, 0.26), 0.080, (0.20, 0.243)),
        ],
        "link_2": [
            _cylinder("y", (0.0, 0.005), 0.060, (-0.241, -0.20)),
            _cylinder("y", (0.0, 0.68), 0.055, (-0.246, -0.20)),
        ],
        "link_3": [
            _cylinder("x", (-0.03, 0.05), 0.048, (-0.352, -0.18)),
            _cylinder("x", (0.06, -0.03), 0.048, (-0.352, -0.18)),
            _cylinder("x", (-0.02, -0.10), 0.048, (-0.352, -0.18)),
            _cylinder("y", (0.0, 0.0), 0.070, (0.18, 0.212)),
        ],
        "link_4": [_cylinder("x", (0.0, 0.0), LINK_4_RADIUS_M - 0.001, (-0.267, -0.235))],
        "link_5": [_cylinder("x", (0.0, 0.0), 0.040, (0.13, 0.147))],
    }  # fmt: skip
    meshes = {}
    for suffix, parts in (("", body), ("_dark", dark)):
        for link, tubes in parts.items():
            mesh = Mesh()
            for rings in tubes:
                mesh.add_rings(rings)
            meshes[link + suffix] = mesh
    return meshes


def _hull(link: str) -> Mesh:
    """The convex hull of a link's sections."""
    given = coal.StdVec_Vec3s()
    for point in corners(link):
        given.append(np.array(point))
    hull = coal.Convex.convexHull(given, True, "Qt")
    rounded = [np.round(hull.point(i), 4).tolist() for i in range(hull.num_points)]
    order = sorted(range(len(rounded)), key=rounded.__getitem__)
    points: list[Point] = [(rounded[i][0], rounded[i][1], rounded[i][2]) for i in order]
    place = {old: new for new, old in enumerate(order)}
    middle = np.mean(points, axis=0)
    faces = []
    for f in range(hull.num_polygons):
        a, b, c = (place[hull.polygons(f)[k]] for k in range(3))
        outward = np.cross(np.subtract(points[b], points[a]), np.subtract(points[c], points[a]))
        if np.dot(outward, points[a] - middle) < 0:
            b, c = c, b
        faces.append(min((a, b, c), (b, c, a), (c, a, b)))
    return Mesh(points, sorted(faces))


def meshes() -> dict[str, str]:
    """Every mesh file: path below `meshes/` to its text."""
    texts = {
        f"collision/{link}.obj": _hull(link).text(f"KR 16 {link}, hull of its sections") for link in SLABS
    }
    return texts | {f"visual/{name}.obj": mesh.text(f"KR 16 {name}") for name, mesh in _visuals().items()}


def main() -> None:
    """Write every mesh file."""
    for name, text in meshes().items():
        path = FOLDER / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="ascii")


if __name__ == "__main__":
    main()
