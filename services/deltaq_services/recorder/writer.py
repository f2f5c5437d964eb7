"""Writes a recording: an MCAP file of protobuf messages, one channel a topic and robot.

The gate's inputs and outputs are written in the gate's own order: each input, then the outputs that answered it, all
with the input's number as the MCAP sequence number. `deltaq recording replay` relies on that order; viewers sort by
time.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable
from pathlib import Path
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
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer

from deltaq_cell.cell_model import robots_told
from deltaq_cell.load import parse_cell
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import GateMemory
from deltaq_protocol.messages import Description, Message, RobotState
from deltaq_protocol.topic import Topic
from deltaq_protocol.topics import GATE_MEMORY, STATE
from deltaq_services.recorder.protobuf import recorded_schema

WORLD = "world"


class Frames:
    """Joint states and poses of the links of a cell's robots in Foxglove's schemas, so that a 3D view shows the robots.

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


METADATA = "deltaq"
CELL_FILE = "cell.yaml"
HULLS_FILE = "hulls.json"
TRANSFORMS = "/tf"

_CHUNK_BYTES = 256 * 1024
"""Largest loss when the recorder is killed, uncompressed."""

_TRANSFORMS_PERIOD_NS = 33_000_000


class RecordingError(DeltaqError):
    """A recording that cannot be written."""


class RecordingWriter:
    """A recording in the making; a context manager that completes the file.

    Args:
        path: file to write; it must not exist.
        description: of the cell, from the HLI.
        source: `live` or `virtual time`.

    Attributes:
        messages: written so far.
        gate_messages: those of them that the gate took.

    Raises:
        RecordingError: if the file exists or cannot be written.
    """

    def __init__(self, path: Path, description: Description, source: str) -> None:
        self.messages = 0
        self.gate_messages = 0
        self._path = path
        self._cell = description.cell
        self._schema = recorded_schema()
        self._frames = Frames(description)
        self._fingerprint: str | None = None
        self._next_transforms_ns = dict.fromkeys(description.robots, 0)
        try:
            self._file = path.open("xb" if not path.is_char_device() else "wb")
        except FileExistsError:
            raise RecordingError(
                f"{path} exists already; a recording is never overwritten, name another file"
            ) from None
        except OSError as error:
            raise RecordingError(f"{path} cannot be written: {error.strerror}") from error
        self._open = True
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        about = {
            "cell": description.cell,
            "cycle_s": repr(description.cycle_s),
            "protocol": str(description.protocol),
            "source": source,
            "robots": " ".join(description.robots),
            "identity": description.identity,
        }
        self._carefully(self._begin, about, description)

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def publish(self, topic: Topic, message: Message, time_ns: int) -> None:
        """Write a message of a stream, with joint states and transforms where it is a robot's state.

        Args:
            topic: its row of the table.
            message: of the topic's type.
            time_ns: when it was seen [ns].

        Raises:
            RecordingError: the file cannot be written to; earlier messages stay in it.
        """
        self._carefully(self._put, topic, message, time_ns, 0)
        if topic is STATE and isinstance(message, RobotState):
            self._carefully(self._put_frames, message, time_ns)

    def gate_took(
        self,
        topic: Topic,
        message: Message,
        outputs: Iterable[tuple[Topic, Message]],
        number: int,
        time_ns: int,
    ) -> None:
        """Write a message that the gate took, and its outputs; raises as `publish` does."""
        self.gate_messages += 1
        self._carefully(self._put, topic, message, time_ns, number)
        for output_topic, output in outputs:
            self._carefully(self._put, output_topic, output, time_ns, number)

    def gate_remembers(self, memory: GateMemory, time_ns: int) -> None:
        """Write a snapshot of the gate, from which a replay can begin; raises as `publish` does."""
        if self._fingerprint != memory.fingerprint:
            self._fingerprint = memory.fingerprint
            self._carefully(self._writer.add_metadata, "gate", {"fingerprint": memory.fingerprint})
        self._carefully(self._put, GATE_MEMORY, memory, time_ns, memory.number)
        self._carefully(self._file.flush)

    def close(self) -> None:
        """Complete the file; raises as `publish` does."""
        if self._open:
            self._carefully(self._writer.finish)
            self._carefully(self._file.close)
            self._open = False

    def _begin(self, about: dict[str, str], description: Description) -> None:
        self._writer.add_metadata(METADATA, about)
        # the hulls before the URDFs: a reader is done after the last of those
        texts = [
            (CELL_FILE, "application/yaml", description.yaml),
            (HULLS_FILE, "application/json", json.dumps(description.hulls)),
            *((f"{name}.urdf", "application/xml", text) for name, text in description.urdf.items()),
        ]
        for name, media_type, text in texts:
            self._writer.add_attachment(0, 0, name, media_type, text.encode())

    def _put(self, topic: Topic, message: Message, time_ns: int, number: int) -> None:
        robot = getattr(message, "robot", None) or ""
        key = topic.key(self._cell, robot=robot)
        self._write(key, self._schema.encode(message), time_ns, number)

    def _put_frames(self, state: RobotState, time_ns: int) -> None:
        self._write(f"/{state.robot}/joint_states", self._frames.joint_states(state, time_ns), time_ns)
        if time_ns >= self._next_transforms_ns[state.robot]:
            self._next_transforms_ns[state.robot] = time_ns + _TRANSFORMS_PERIOD_NS
            self._write(TRANSFORMS, self._frames.transforms(state, time_ns), time_ns)

    def _write(self, key: str, message: Any, time_ns: int, number: int = 0) -> None:
        self.messages += 1
        self._writer.write_message(key, message, time_ns, time_ns, number % 2**32)

    def _carefully(self, write: Any, *arguments: Any) -> None:
        try:
            write(*arguments)
        except OSError as error:
            self._open = False
            with contextlib.suppress(OSError):  # buffered messages are lost with the rest
                self._file.close()
            raise RecordingError(
                f"{self._path} can no longer be written: {error.strerror}; messages written so far can be read"
            ) from error
