"""The cell as a browser draws it: one JSON document and the visual meshes that it names.

Poses are 4 by 4, homogeneous, written as 16 numbers column by column. The forward kinematics of a robot: the pose of a
joint is `T(parent) * parent_T_joint * motion(axis, q)`, where `T(-1)` is `T_world_base` and the motion is a turn about
the axis, or a displacement along it. Bodies of the joint -1 are fixed to the base. A camera looks along its z axis, and
its x axis points up in the picture.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from deltaq_cell.cell_model import CellModel, joint_axis
from deltaq_cell.description import CellDescription
from deltaq_cell.robot import RobotModel
from deltaq_cell.roles import RoleError, camera_roles
from deltaq_protocol.arrays import Array
from deltaq_protocol.pad_layout import PAD_LAYOUT, VIEW_RANGE_M, VIEW_STEP_M
from deltaq_services.console.feed import OUTCOMES, PHASES

MESHES = "/meshes"
"""Path under which meshes are served."""


@dataclass
class BrowserScene:
    """The data from which a browser draws a cell.

    Attributes:
        document: the description as JSON has it.
        meshes: OBJ text by the name under which it is served.
        bodies: names of all bodies; frames name a body by its place here.
    """

    document: dict[str, Any]
    meshes: dict[str, str] = field(default_factory=dict)
    bodies: tuple[str, ...] = ()


def scene_of(cell: CellModel, emulated: bool) -> BrowserScene:
    """The scene of a cell; `emulated` says that no robot of it is real."""
    meshes: dict[str, str] = {}
    names = [body.name for robot in cell.robots.values() for body in robot.geometry.geometryObjects]
    names += [body.name for body in cell.structure]
    robots = [_robot(robot, meshes) for robot in cell.robots.values()]
    links = [link["name"] for robot in robots for link in robot["links"]]
    document = {
        "cell": cell.description.cell,
        "hash": str(cell.identity),
        "emulated": emulated,
        "cycle_s": cell.description.cycle_s,
        "robots": robots,
        "structure": [
            {"name": body.name, **_shape(body, meshes), "T_world": _columns(body.placement)}
            for body in cell.structure
        ],
        "equipment": list(_equipment(cell.description)),
        "bodies": names,
        "body_links": [_drawn_by(name, links) for name in names],
        "pad": pad_document(),
        "phases": list(PHASES),
        "outcomes": list(OUTCOMES),
    }
    return BrowserScene(document, meshes, tuple(names))


def _equipment(cell: CellDescription) -> Iterator[dict[str, Any]]:
    """Items of equipment, each with the robot that works on it."""
    try:
        leader = camera_roles(cell).leader
    except RoleError:  # no camera
        leader = next(iter(cell.robots))
    for name, item in cell.equipment.items():
        bodies = [f"structure/{body}" for body in item.bodies]
        yield {"name": name, "kind": item.kind, "robot": item.robot or leader, "bodies": bodies}


def pad_document() -> dict[str, Any]:
    """The functions of a gamepad's controls, and their steps [m]."""
    return {
        "controls": [asdict(control) for control in PAD_LAYOUT],
        "view_step_m": VIEW_STEP_M,
        "view_range_m": list(VIEW_RANGE_M),
    }


def _drawn_by(body: str, links: Sequence[str]) -> str:
    """What shows a body: its link, to whose name each of several bodies adds its own, or a body of the structure."""
    owners = [link for link in links if body == link or body.startswith(f"{link}_")]
    return max(owners, key=len, default=body)


def _robot(robot: RobotModel, meshes: dict[str, str]) -> dict[str, Any]:
    model = robot.model
    camera = robot.description.camera
    return {
        "name": robot.name,
        "T_world_base": _columns(robot.T_world_base),
        "joints": [_joint(robot, index) for index in range(robot.n)],
        "links": list(_links(robot, meshes)),
        "tools": [
            {
                "name": name,
                "joint": int(model.frames[robot.frame_of(name)].parentJoint) - 1,
                "T_joint_tool": _columns(_on_joint(robot, robot.frame_of(name))),
            }
            for name in robot.hands
        ],
        "exchangeable": {
            name: {
                "joint": int(model.frames[robot.frame_of(name)].parentJoint) - 1,
                "T_joint_tool": _columns(_on_joint(robot, robot.frame_of(name))),
            }
            for name in robot.tool_bodies
        },
        "camera": None
        if camera is None
        else {
            "joint": int(model.frames[robot.frame_of("camera")].parentJoint) - 1,
            "T_joint_camera": _columns(_on_joint(robot, robot.frame_of("camera"))),
            "fov_rad": float(np.deg2rad(camera.vertical_view_deg)),
            "baseline_m": camera.baseline_m or None,
            "video": [f"{robot.name}{end}" for end in camera.eyes],
        },
        "home": robot.home.tolist(),
        "outputs": list(robot.description.outputs),
        "inputs": list(robot.description.inputs),
    }


def _joint(robot: RobotModel, index: int) -> dict[str, Any]:
    model, joint = robot.model, index + 1
    parent = int(model.parents[joint])
    place = model.jointPlacements[joint]
    if parent == 0:
        place = _base(robot).inverse() * place
    revolute = bool(robot.revolute[index])
    return {
        "name": robot.joint_names[index],
        "kind": "revolute" if revolute else "prismatic",
        "parent": parent - 1,
        "parent_T_joint": _columns(place),
        "axis": list(joint_axis(robot, index)),
        "lower": float(robot.lower[index]),
        "upper": float(robot.upper[index]),
        "max_speed": float(robot.max_velocity[index]),
        "unit": "rad" if revolute else "m",
    }


def _links(robot: RobotModel, meshes: dict[str, str]) -> Iterator[dict[str, Any]]:
    """The visual bodies by the link that has them; links that cannot move against one another stay apart."""
    links: dict[str, dict[str, Any]] = {}
    for body in robot.visual.geometryObjects:
        # pinocchio numbers the bodies of a link; bodies that the cell adds have their full name
        is_bolted = body.name.startswith(f"{robot.name}/")
        name = body.name if is_bolted else f"{robot.name}/{body.name.rsplit('_', 1)[0]}"
        joint = int(body.parentJoint) - 1
        place = body.placement if joint >= 0 else _base(robot).inverse() * body.placement
        tool = next((each for each, bodies in robot.tool_bodies.items() if body.name in bodies), None)
        link = links.setdefault(name, {"joint": joint, "name": name, "tool": tool, "meshes": []})
        link["meshes"].append({**_shape(body, meshes), "T_link_mesh": _columns(place)})
    yield from links.values()


def _shape(body: pin.GeometryObject, meshes: dict[str, str]) -> dict[str, Any]:
    """Kind and size of a body [m], or the address of its mesh; cylinders and capsules stand along z."""
    shape = body.geometry
    told: dict[str, Any] = {"rgba": [float(number) for number in body.meshColor]}
    if isinstance(shape, coal.Box):
        return told | {"kind": "box", "size": (2.0 * shape.halfSide).tolist(), "url": None}
    if isinstance(shape, coal.Cylinder):
        return told | {"kind": "cylinder", "size": [shape.radius, 2.0 * shape.halfLength], "url": None}
    if isinstance(shape, coal.Capsule):
        return told | {"kind": "capsule", "size": [shape.radius, 2.0 * shape.halfLength], "url": None}
    if isinstance(shape, coal.Sphere):
        return told | {"kind": "sphere", "size": [shape.radius], "url": None}
    text = _obj_text(shape)
    name = f"{hashlib.sha256(text.encode()).hexdigest()[:16]}.obj"
    meshes[name] = text
    return told | {"kind": "mesh", "size": [], "url": f"{MESHES}/{name}"}


def _obj_text(shape: Any) -> str:
    """A mesh as an OBJ file."""
    if isinstance(shape, coal.Convex):
        corners = np.array([shape.point(index) for index in range(shape.num_points)])
        faces = [shape.polygons(index) for index in range(shape.num_polygons)]
    else:
        corners = np.array(shape.vertices())
        faces = [shape.tri_indices(index) for index in range(shape.num_tris)]
    lines = [f"v {x:.6g} {y:.6g} {z:.6g}" for x, y, z in corners]
    # coal's triangles have no length and no end
    lines += [f"f {' '.join(str(int(face[corner]) + 1) for corner in range(3))}" for face in faces]
    return "\n".join(lines) + "\n"


def _base(robot: RobotModel) -> pin.SE3:
    return pin.SE3(robot.T_world_base)


def _on_joint(robot: RobotModel, frame: int) -> pin.SE3:
    place = robot.model.frames[frame].placement
    return place if robot.model.frames[frame].parentJoint > 0 else _base(robot).inverse() * place


def _columns(pose: pin.SE3 | Array | Sequence[Sequence[float]]) -> list[float]:
    matrix = pose.homogeneous if isinstance(pose, pin.SE3) else np.asarray(pose)
    return [float(number) for number in matrix.flatten(order="F")]
