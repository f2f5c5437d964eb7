"""One robot of a cell: its kinematics through pinocchio, and its bodies, in world coordinates."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from deltaq_cell.description import RobotDescription
from deltaq_cell.hull import Corners
from deltaq_cell.models import RobotModelError, Urdf, collision_names, load_urdf, urdf_from_text
from deltaq_cell.never_checked import Pair, Why, never_checked
from deltaq_cell.robot_bodies import (
    CarriedFrames,
    PointName,
    check_rotations,
    check_sizes,
    collision_geometry,
    hulls_of,
    placement,
    reach,
)
from deltaq_cell.urdf_parsing import MissingMeshError, parse_geometry, parse_model
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import ToolPose


class RobotModel:
    """Kinematics and bodies of one robot.

    Vectors are in the joint order of the description, rad for revolute and m for prismatic joints; poses map
    into world coordinates, in m.

    Args:
        description: the robot as its cell describes it.
        name: the robot's name in the cell; its bodies' names begin with it (`fr/link_5`).
        urdf: URDF or its text to use in place of `description.model`, e.g. one that came over the network.
        hulls: hulls that came with it: of bodies whose meshes need not be found, by name without the robot's.

    Attributes:
        description: as given.
        name: as given.
        urdf: the URDF text.
        model: `pinocchio.Model`; its world is the cell's world (the base pose is part of it).
        geometry: `pinocchio.GeometryModel` of the collision bodies, in the order of the joints that move them.
            Meshes are taken for their convex hulls.
        hulls: corners of those hulls, by the body's name without the robot's.
        hands: names of the frames that the robot works with: its hands', or `tool` alone.
        tool_bodies: names of the bodies of each exchangeable tool. The model has all of them; see `with_tool`.
        T_world_base: (4, 4) pose of the robot's root link.

    Raises:
        RobotModelError: the model is not found, or does not fit the description.
    """

    def __init__(
        self,
        description: RobotDescription,
        name: str,
        urdf: str | Urdf | None = None,
        hulls: Mapping[str, Corners] | None = None,
    ) -> None:
        self.description = description
        self.name = name
        source = load_urdf(description.model) if urdf is None else urdf
        source = urdf_from_text(source) if isinstance(source, str) else source
        self.urdf = source.text
        self._source = source
        self._T_world_base = placement(description.base)
        self.T_world_base: Array = _frozen(self._T_world_base.homogeneous)
        self.model = parse_model(source, description.locked_joints)
        self._check_joints()
        self._bake_base_pose()
        self._carried = CarriedFrames(description, name, self.model, source.source)
        self.hands = self._carried.hands
        self._data = self.model.createData()
        self.geometry = collision_geometry(
            source,
            name,
            self._T_world_base,
            description.locked_joints,
            hulls or {},
            self._carried.bolted_bodies(),
        )
        if not self.geometry.ngeoms:
            text = (
                f"{source.source}: no link has a collision body, so the gate could not keep the robot clear"
            )
            raise RobotModelError(text, ("model",))
        self.hulls: dict[str, Corners] = hulls_of(self.geometry, name)
        self.tool_bodies = {
            tool: frozenset(f"{name}/{tool}_{body}" for body in described.bodies)
            for tool, described in description.tools.items()
        }
        self._absent: frozenset[str] = frozenset()
        self._every, self._with_tool = self, dict[tuple[str, str], RobotModel]()
        bodies = list(self.geometry.geometryObjects)
        check_rotations(self.model, bodies, (self.home, self.lower, self.upper), source.source)
        check_sizes(bodies, reach(self.model, self.lower, self.upper, self._T_world_base), source.source)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return self.description.joint_names

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.description.joints)

    @property
    def lower(self) -> Array:
        """(n,) lower limits [rad or m], read-only."""
        return self.description.lower

    @property
    def upper(self) -> Array:
        """(n,) upper limits [rad or m], read-only."""
        return self.description.upper

    @property
    def max_velocity(self) -> Array:
        """(n,) largest speeds [rad/s or m/s], read-only."""
        return self.description.max_velocity

    @property
    def max_acceleration(self) -> Array:
        """(n,) largest accelerations [rad/s^2 or m/s^2], read-only."""
        return self.description.max_acceleration

    @property
    def home(self) -> Array:
        """(n,) home configuration [rad or m], read-only."""
        return self.description.home

    @cached_property
    def revolute(self) -> NDArray[np.bool_]:
        """(n,) True for revolute joints, False for prismatic ones."""
        return np.array([unit == "rad" for unit in self.description.units])

    def with_tool(self, tool: str | None, frame: str | None = None) -> RobotModel:
        """The robot with one of its exchangeable tools: its bodies, mass, and `tool` frame; made once.

        Args:
            tool: the name of the tool; empty: with none of them; None, since it is not known: the model of them all.
            frame: the tool whose frame `tool` is, empty for the changer's own; None: that of the tool.
        """
        every = self._every
        if tool is None or not self.tool_bodies:
            return every
        key = tool, tool if frame is None else frame
        if key not in self._with_tool:
            other = copy.copy(every)
            other.__dict__.pop("visual", None)
            other._absent = frozenset().union(
                *(bodies for each, bodies in self.tool_bodies.items() if each != tool)
            )
            other.model, other._carried = every.model.copy(), every._carried.with_tool(key[1])
            if tool and (mass_kg := self.description.tools[tool].mass_kg):
                held = other.model.frames[other.frame_of(tool)]
                point = pin.Inertia(mass_kg, np.zeros(3), np.zeros((3, 3)))
                other.model.appendBodyToJoint(held.parentJoint, point, held.placement)
            other._data = other.model.createData()
            other.geometry = pin.GeometryModel()
            for body in every.geometry.geometryObjects:
                if body.name not in other._absent:
                    other.geometry.addGeometryObject(body)
            self._with_tool[key] = other
        return self._with_tool[key]

    def forward(self, q: ArrayLike, hand: PointName = "tool") -> Array:
        """(4, 4) `T_world_tool` of the configuration `q` (n,), of the first hand or of a named one."""
        return self._frame_pose(q, self.frame_of(hand))

    def camera_pose(self, q: ArrayLike) -> Array:
        """(4, 4) `T_world_camera` of the configuration `q` (n,); its z axis is the view axis.

        Raises:
            RobotModelError: the robot carries no camera.
        """
        return self._frame_pose(q, self.frame_of("camera"))

    def tool_pose(self, q: ArrayLike, point: PointName = "tool") -> ToolPose:
        """The pose of a tool as messages carry it: position [m] and unit quaternion, w not negative."""
        px, py, pz, x, y, z, w = pin.SE3ToXYZQUAT(self._frame_placement(q, self.frame_of(point))).tolist()
        sign = -1.0 if w < 0 else 1.0
        return ToolPose(position=(px, py, pz), quaternion_wxyz=(sign * w, sign * x, sign * y, sign * z))

    def jacobian(self, q: ArrayLike, point: PointName = "tool") -> Array:
        """(6, n) Jacobian of the tool's, a hand's or the camera's origin at `q` (n,), world axes.

        Rows 0 to 2 are the velocity of that point [m/s], rows 3 to 5 the angular velocity [rad/s], per unit
        of joint velocity.
        """
        jacobian: Array = pin.computeFrameJacobian(
            self.model, self._data, self._checked(q), self.frame_of(point), pin.LOCAL_WORLD_ALIGNED
        )
        return np.reshape(jacobian, (6, -1))  # of a robot with one joint pinocchio gives a vector

    def frame_of(self, point: PointName) -> int:
        """Index in `model.frames` of a frame that the robot carries: `tool`, `camera` or a hand.

        Raises:
            RobotModelError: the robot carries no such frame.
        """
        return self._carried.of(point)

    def joint_origins(self, q: ArrayLike) -> Array:
        """(n, 3) a point on each joint's axis at `q` (n,), in world coordinates [m]."""
        pin.forwardKinematics(self.model, self._data, self._checked(q))
        return np.array([self._data.oMi[joint].translation for joint in range(1, self.model.njoints)])

    def never_checked_pairs(self) -> frozenset[Pair]:
        """Pairs of body names that are never checked, each sorted."""
        return frozenset(self.never_checked)

    @cached_property
    def never_checked(self) -> dict[Pair, Why]:
        """Pairs of body names that are never checked, each sorted, and why.

        Raises:
            RobotModelError: the cell names a body that the robot does not have.
        """
        links = collision_names(self._source)
        return never_checked(
            self.model, list(self.geometry.geometryObjects), links, self.description, self.name
        )

    @cached_property
    def visual(self) -> pin.GeometryModel:
        """`pinocchio.GeometryModel` of the visual bodies, attachments and tool bodies included.

        Visual meshes are not part of a description. Where one is not found here, the hulls are shown.
        """
        locked = self.description.locked_joints
        try:
            visual = parse_geometry(self._source, pin.GeometryType.VISUAL, self._T_world_base, locked)
        except MissingMeshError:
            return self.geometry
        for body in self._carried.bolted_bodies():
            if body.name in self._absent:
                continue
            visual.addGeometryObject(body)
        return visual

    def _check_joints(self) -> None:
        model, given = self.model, self.joint_names
        found = tuple(model.names[1:])
        if found != given:
            raise RobotModelError(
                f"robot '{self.name}': the joints must be those of {self._source.source} in its order: expected "
                f"{', '.join(found) or 'none'}; got {', '.join(given)}",
                ("joints",),
            )
        for index, joint in enumerate(self.description.joints.values(), start=1):
            kind = model.joints[index].shortname()
            if model.joints[index].nq != 1:
                raise RobotModelError(
                    f"robot '{self.name}': joint '{given[index - 1]}' is a {kind}; only revolute joints "
                    "(with limits) and prismatic joints are supported",
                    ("joints", given[index - 1]),
                )
            if ("Prismatic" in kind or "JointModelP" in kind) == joint.revolute:
                raise RobotModelError(
                    f"robot '{self.name}': joint '{given[index - 1]}' is a {kind} in {self._source.source}, "
                    f"but its limits are given in {'deg' if joint.revolute else 'm'}",
                    ("joints", given[index - 1]),
                )

    def _bake_base_pose(self) -> None:
        """Put the base pose into the model, so that its world is the cell's."""
        for joint in range(1, self.model.njoints):
            if self.model.parents[joint] == 0:
                self.model.jointPlacements[joint] = self._T_world_base * self.model.jointPlacements[joint]
        for index in range(1, self.model.nframes):
            frame = self.model.frames[index]
            if frame.parentJoint == 0:
                frame.placement = self._T_world_base * frame.placement

    def _frame_pose(self, q: ArrayLike, frame: int) -> Array:
        pose: Array = self._frame_placement(q, frame).homogeneous
        return pose

    def _frame_placement(self, q: ArrayLike, frame: int) -> pin.SE3:
        pin.forwardKinematics(self.model, self._data, self._checked(q))
        return pin.updateFramePlacement(self.model, self._data, frame)

    def _checked(self, q: ArrayLike) -> Array:
        vector = np.asarray(q, dtype=np.float64)
        if vector.shape != (self.n,):
            raise RobotModelError(
                f"robot '{self.name}': q must have shape ({self.n},) for {', '.join(self.joint_names)}, "
                f"got shape {vector.shape}"
            )
        return vector


def _frozen(array: Array) -> Array:
    array.flags.writeable = False
    return array
