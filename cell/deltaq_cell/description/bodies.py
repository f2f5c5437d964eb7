"""Shapes, bodies, tools and cameras."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from deltaq_cell.description.base import DescriptionModel, Pose, Positive
from deltaq_protocol.messages import Name


class BoxShape(DescriptionModel):
    """A box, its frame at its centre."""

    kind: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]


class CylinderShape(DescriptionModel):
    """A cylinder along z, its frame at its centre."""

    kind: Literal["cylinder"]
    radius_m: Positive
    length_m: Positive


class CapsuleShape(DescriptionModel):
    """A cylinder along z with round ends, its frame at its centre; the length leaves the ends out."""

    kind: Literal["capsule"]
    radius_m: Positive
    length_m: Positive


class SphereShape(DescriptionModel):
    """A sphere."""

    kind: Literal["sphere"]
    radius_m: Positive


Shape = Annotated[BoxShape | CylinderShape | CapsuleShape | SphereShape, Field(discriminator="kind")]
Colour = tuple[float, float, float, float]


class Body(DescriptionModel):
    """A rigid body: fixed to the world (structure) or to a link of a robot (attachment)."""

    shape: Shape
    pose: Pose = Pose()
    colour_rgba: Colour = (0.6, 0.6, 0.62, 1.0)


class Attachment(Body):
    """A body bolted to a link of a robot, e.g. a control box or a camera housing."""

    link: str


class Camera(DescriptionModel):
    """A camera in the flange frame; its z axis is the view axis, its x axis points up in the picture.

    A stereo camera has an eye on either side of that frame, along its y axis.
    """

    pose: Pose = Pose()
    vertical_view_deg: Annotated[float, Field(gt=1, lt=170)] = 45.0
    aspect: Annotated[float, Field(gt=0.1, lt=10)] = 1.5
    """Width of a picture by its height."""
    baseline_m: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Distance between the eyes of a stereo camera; 0 for a single one."""


class Tool(DescriptionModel):
    """What the flange carries: where the tool frame is, and the bodies of the tool, in the flange frame."""

    frame: Pose = Pose()
    bodies: dict[Name, Body] = {}


class Hand(Tool):
    """A hand of a robot that has several: a tool on a link of its own; the frame and the bodies are in its frame."""

    link: str
