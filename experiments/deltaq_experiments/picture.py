"""A picture of a cell: `python -m deltaq_experiments.picture docs/images/lab.png`."""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path
from typing import Any

import coal
import matplotlib.colors
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.arrays import Array

_SIDES = 20
_HIDDEN = ("floor",)
_LIGHT = np.array([0.35, 0.55, 0.75])


def draw(cell: CellModel, file: Path) -> None:
    """Draw a cell with its robots at home.

    Args:
        cell: the cell.
        file: picture to write.
    """
    figure = plt.figure(figsize=(9, 8))
    axes: Any = figure.add_subplot(projection="3d")
    for robot in cell.robots.values():
        data, visual_data = robot.model.createData(), robot.visual.createData()
        pin.updateGeometryPlacements(robot.model, data, robot.visual, visual_data, robot.home)
        for body, placement in zip(robot.visual.geometryObjects, visual_data.oMg, strict=True):
            _add(axes, body, placement)
    for body in cell.structure:
        if body.name.removeprefix("structure/") not in _HIDDEN:
            _add(axes, body, body.placement)
    axes.set(xlim=(-2.2, 1.8), ylim=(-3.4, 1.6), zlim=(0, 4))
    axes.set_box_aspect((4, 5, 4), zoom=1.45)
    axes.view_init(elev=14, azim=28)
    axes.set_axis_off()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110, bbox_inches="tight")
    plt.close(figure)


def _add(axes: Any, body: Any, placement: Any) -> None:
    faces = _faces(body.geometry)
    if faces is None:
        return
    faces = faces @ placement.rotation.T + placement.translation
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    shade = 0.55 + 0.45 * np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT)))
    colour = np.array(matplotlib.colors.to_rgb(tuple(np.clip(body.meshColor[:3], 0, 1))))
    axes.add_collection3d(Poly3DCollection(faces, facecolors=np.clip(shade[:, None] * colour, 0, 1)))


def _faces(shape: Any) -> Array | None:
    """(k, corners, 3) flat faces of a shape in its own frame; None for shapes that are not drawn."""
    if isinstance(shape, coal.Box):
        return _prism(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * shape.halfSide[:2], shape.halfSide[2])
    if isinstance(shape, coal.Cylinder | coal.Capsule):
        extra = shape.radius if isinstance(shape, coal.Capsule) else 0.0
        return _prism(shape.radius * _circle(), shape.halfLength + extra)
    if isinstance(shape, coal.Sphere):
        return _ball(shape.radius)
    if hasattr(shape, "vertices"):
        corners = np.array(shape.vertices())
        indices = [[t[0], t[1], t[2]] for t in (shape.tri_indices(k) for k in range(shape.num_tris))]
        triangles: Array = corners[np.array(indices)]
        return triangles
    return None


def _circle() -> Array:
    angles = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def _prism(outline: Array, half_length: float) -> Array:
    """Sides and ends of a prism along z as quadrilaterals."""
    following = np.roll(outline, -1, axis=0)
    low, high = np.full(len(outline), -half_length), np.full(len(outline), half_length)

    def at(points: Array, z: Array) -> Array:
        return np.column_stack([points, z])

    sides = np.stack([at(outline, low), at(following, low), at(following, high), at(outline, high)], axis=1)
    centre = np.zeros_like(outline)
    ends = [
        np.stack([at(centre, z), at(outline, z), at(following, z), at(following, z)], axis=1)
        for z in (low, high)
    ]
    return np.concatenate([sides, *ends])


def _ball(radius: float) -> Array:
    heights = np.linspace(-np.pi / 2, np.pi / 2, 9)
    rings = [np.column_stack([np.cos(h) * _circle(), np.full(_SIDES, np.sin(h))]) for h in heights]
    faces = [
        np.stack([low, np.roll(low, -1, axis=0), np.roll(high, -1, axis=0), high], axis=1)
        for low, high in pairwise(rings)
    ]
    return radius * np.concatenate(faces)


def main() -> None:
    """Draw the cell named on the command line."""
    parser = argparse.ArgumentParser(description="Draw a cell with its robots at home.")
    parser.add_argument("file", type=Path, help="picture to write")
    parser.add_argument("--cell", default="lab", help="name or file of the cell (default: %(default)s)")
    options = parser.parse_args()
    draw(CellModel.load(options.cell), options.file)


if __name__ == "__main__":
    main()
