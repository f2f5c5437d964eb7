"""What a robot carries: the frames of its tool, hands and camera, and the bodies that are bolted to its links."""

from __future__ import annotations

import pinocchio as pin

from deltaq_cell.description import Pose, RobotDescription
from deltaq_cell.models import RobotModelError, nearest_name
from deltaq_cell.structure import body_geometry, placement

FLANGE_LINKS = ("flange", "tool0")
"""The link that carries the tool, by name; a model without one carries it on its last link."""

PointName = str
"""A frame that a robot carries: `tool`, `camera`, or the name of one of its hands."""


class CarriedFrames:
    """Adds the frames of tool, hands and camera to a robot's model.

    Args:
        description: the robot as its cell describes it.
        name: the robot's name in the cell; its bodies' names begin with it (`fr/link_5`).
        model: `pinocchio.Model`, is added to.
        source: what an error calls the model.

    Attributes:
        hands: names of the frames that the robot works with: its hands', or `tool` alone.

    Raises:
        RobotModelError: the description names a link that the model does not have.
    """

    def __init__(self, description: RobotDescription, name: str, model: pin.Model, source: str) -> None:
        self.hands: tuple[str, ...] = tuple(description.hands) or ("tool",)
        self._description = description
        self._name = name
        self._model = model
        self._source = source
        self._flange = self._flange_frame()
        self._frames = self._added()

    def of(self, point: PointName) -> int:
        """Index in `model.frames` of a frame that the robot carries: `tool`, `camera` or a hand.

        Raises:
            RobotModelError: the robot carries no such frame.
        """
        if point in self._frames:
            return self._frames[point]
        if point == "camera":
            raise RobotModelError(
                f"robot '{self._name}' carries no camera; add one under robots.{self._name}.camera"
            )
        raise RobotModelError(
            f"point must be one of {', '.join(self._frames)}, got {point!r}",
            suggestion=nearest_name(point, self._frames),
        )

    def bolted_bodies(self) -> list[pin.GeometryObject]:
        """Attachments, and the bodies of tool or hands."""
        bolted = []
        for name, attachment in self._description.attachments.items():
            link = self._model.frames[self._link_frame(attachment.link, "attachments", name)]
            bolted.append(body_geometry(f"{self._name}/{name}", attachment, link.parentJoint, link.placement))
        carried = [("tool", self._flange, self._description.tool)]
        for name, hand in self._description.hands.items():
            carried.append((name, self._link_frame(hand.link, "hands", name), hand))
        for prefix, frame, tool in carried:
            flange = self._model.frames[frame]
            for name, body in tool.bodies.items():
                full_name = f"{self._name}/{prefix}_{name}"
                bolted.append(body_geometry(full_name, body, flange.parentJoint, flange.placement))
        return bolted

    def _added(self) -> dict[PointName, int]:
        description = self._description
        frames = {}
        for name, hand in description.hands.items():
            frames[name] = self._add_frame(name, hand.frame, self._link_frame(hand.link, "hands", name))
        first = description.hands[self.hands[0]].frame if description.hands else description.tool.frame
        frames["tool"] = self._add_frame("tool", first, self._flange)
        if description.camera is not None:
            frames["camera"] = self._add_frame("camera", description.camera.pose, self._flange)
        return frames

    def _flange_frame(self) -> int:
        if self._description.hands:
            first = self.hands[0]
            return self._link_frame(self._description.hands[first].link, "hands", first)
        links = [i for i, frame in enumerate(self._model.frames) if frame.type == pin.FrameType.BODY]
        named = [i for i in links if self._model.frames[i].name in FLANGE_LINKS]
        return (named or links)[-1]

    def _link_frame(self, link: str, *field: str) -> int:
        links = [frame.name for frame in self._model.frames if frame.type == pin.FrameType.BODY]
        if link not in links:
            raise RobotModelError(
                f"robot '{self._name}': no link '{link}' in {self._source}; it has {', '.join(links)}",
                (*field, "link"),
                nearest_name(link, links),
            )
        return int(self._model.getFrameId(link, pin.FrameType.BODY))

    def _add_frame(self, name: PointName, pose: Pose, link: int) -> int:
        carrier = self._model.frames[link]
        place = carrier.placement * placement(pose)
        frame = pin.Frame(f"deltaq_{name}", carrier.parentJoint, link, place, pin.FrameType.OP_FRAME)
        return int(self._model.addFrame(frame))
