"""Sections of the KR 16's links: the space that each link takes up, slab by slab, in its link frame [m].

A slab is a box given by its range along x, y and z. The collision hull of a link is the convex hull of its
slabs, so it contains the link; it is larger where the link is hollow or waisted, never smaller.
"""

import math

Range = tuple[float, float]
Slab = tuple[Range, Range, Range]

LINK_4_RADIUS_M = 0.077
"""The rear of link 4 is a tube about its x axis."""
_SIDES = 14


def _along_z(*rows: tuple[Range, Range, float | Range]) -> list[Slab]:
    return [(x, (-y, y) if isinstance(y, float) else y, z) for z, x, y in rows]


def _along_x(*rows: tuple[Range, Range, float | Range]) -> list[Slab]:
    return [(x, y, (-z, z) if isinstance(z, float) else z) for x, y, z in rows]


SLABS: dict[str, list[Slab]] = {
    "base": _along_z(
        ((0.0, 0.079), (-0.359, 0.282), 0.268),
        ((0.079, 0.159), (-0.402, 0.272), 0.261),
        ((0.159, 0.238), (-0.401, 0.258), 0.250),
        ((0.238, 0.318), (-0.399, 0.244), 0.239),
        ((0.318, 0.397), (-0.317, 0.230), 0.228),
    ),
    "link_1": _along_z(
        ((-0.291, -0.199), (-0.270, 0.318), 0.270),
        ((-0.199, -0.106), (-0.220, 0.374), (-0.240, 0.266)),
        ((-0.106, -0.014), (-0.141, 0.393), (-0.198, 0.260)),
        ((-0.014, 0.079), (-0.050, 0.393), (-0.158, 0.255)),
        ((0.079, 0.171), (0.095, 0.367), (-0.117, 0.244)),
    ),
    "link_2": _along_x(
        ((-0.091, 0.082), (-0.242, -0.081), 0.110),
        ((0.082, 0.254), (-0.277, -0.080), 0.106),
        ((0.254, 0.427), (-0.276, -0.078), 0.098),
        ((0.427, 0.600), (-0.276, -0.077), 0.091),
        ((0.600, 0.773), (-0.247, -0.083), 0.083),
    ),
    "link_3": _along_x(
        ((-0.356, -0.205), (-0.080, 0.125), (-0.169, 0.108)),
        ((-0.205, -0.053), (-0.117, 0.213), (-0.172, 0.115)),
        ((-0.053, 0.099), (-0.117, 0.213), (-0.165, 0.115)),
        ((0.099, 0.251), (-0.117, 0.199), (-0.148, 0.103)),
        ((0.251, 0.403), (-0.101, 0.140), (-0.130, 0.073)),
    ),
    "link_4": _along_x(((-0.003, 0.063), (-0.051, 0.071), 0.063)),
    "link_5": _along_x(
        ((-0.059, 0.065), (-0.094, 0.106), 0.060),
        ((0.065, 0.148), (-0.093, 0.092), 0.055),
    ),
}  # fmt: skip


def corners(link: str) -> list[tuple[float, float, float]]:
    """Points whose convex hull contains every section of a link, in its frame [m]."""
    points = [(x, y, z) for xs, ys, zs in SLABS[link] for x in xs for y in ys for z in zs]
    if link == "link_4":  # a polygon about the tube, so that the tube lies inside it
        radius = (LINK_4_RADIUS_M + 1e-4) / math.cos(math.pi / _SIDES)  # margin for rounding in the file
        angles = [2 * math.pi * side / _SIDES for side in range(_SIDES)]
        points += [(x, radius * math.cos(a), radius * math.sin(a)) for x in (-0.268, -0.202) for a in angles]
    return points
