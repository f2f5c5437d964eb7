"""Joint states and frame transforms in Foxglove's well-known schemas, so that a 3D view shows the robots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from deltaq_cell.cell_model import robots_told
from deltaq_cell.load import parse_cell
from deltaq_protocol.messages import Description, RobotState

WORLD = "world"


class Frames:
    """Poses of the links of a cell's robots.

    Args:
        description: from the HLI.
    """

    def __init__(self, description: Description) -> None:
        cell = parse_cell(description.yaml, "the cell's description")
        self._robots = robots_told(cell, description.urdf, description.hulls)
        self._data = {name: robot.model.createData() for name, robot in self._robots.items()}

    def joint_states(self, state: RobotState, time_ns: int) -> Any:
        """The measured joints as `foxglove.JointStates`."""
        names = self._robots[state.robot].joint_names
        return JointStates(
            timestamp=_timestamp(time_ns),
            joints=[JointState(name=name, position=q) for name, q in zip(names, state.q, strict=True)],
        )

    def transforms(self, state: RobotState, time_ns: int) -> Any:
        """The links of the robot as `foxglove.FrameTransforms`, named `fr/link_1` and so on, in the world."""
        model, data = self._robots[state.robot].model, self._data[state.robot]
        pin.framesForwardKinematics(model, data, np.array(state.q))
        stamp = _timestamp(time_ns)
        found = []
        for index, frame in enumerate(model.frames):
            if frame.type is not pin.FrameType.BODY:
                continue
            x, y, z = data.oMf[index].translation.tolist()
            qx, qy, qz, qw = pin.Quaternion(data.oMf[index].rotation).coeffs().tolist()
            found.append(
                FrameTransform(
                    timestamp=stamp,
                    parent_frame_id=WORLD,
                    child_frame_id=f"{state.robot}/{frame.name}",
                    translation=Vector3(x=x, y=y, z=z),
                    rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
                )
            )
        return FrameTransforms(transforms=found)


def _timestamp(time_ns: int) -> Timestamp:
    return Timestamp(seconds=time_ns // 1_000_000_000, nanos=time_ns % 1_000_000_000)
