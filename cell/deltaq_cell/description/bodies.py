"""Shapes, bodies, tools and cameras."""

from __future__ import annotations

import re
from functools import partial
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError
from deltaq_protocol.messages import Name, Vector3

# Base of all parts of a cell's description, and the types of their fields.


def _listens_over(transports: tuple[str, ...], text: str, pattern: str = "") -> str:
    try:
        is_one = Endpoint.parse(text).transport in transports
    except InvalidEndpointError:
        is_one = False
    if not is_one:
        *most, last = (f"{transport}/HOST:PORT" for transport in transports)
        forms = {"pattern": pattern or f"{', '.join(most)} or {last}"}
        raise PydanticCustomError("endpoint", "should be {pattern}, with a port of 1 to 65535", forms)
    return text


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
JointName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z_][A-Za-z0-9_.-]*$")]
"""As its URDF names it."""
EndpointText = Annotated[str, AfterValidator(partial(_listens_over, ("tcp", "tcp+udp", "tls")))]
"""Of the open realm; `tcp+udp` where the network loses packets, `tls` where clients have identities."""
LOCAL = "local"
_LOCAL = re.compile(r"local(/[A-Za-z0-9_-]{1,64})?")


def _listens_guarded(text: str) -> str:
    return text if _LOCAL.fullmatch(text) else _listens_over(("tcp", "tls"), text, "local or tls/HOST:PORT")


GuardedEndpointText = Annotated[str, AfterValidator(_listens_guarded)]
"""Of the guarded realm: `local`, a Unix socket in the folder of the launch, or `local/NAME` to name it; `tls/HOST:PORT`
where services run on several machines and have identities. `tcp/` on the loopback is read as `local`."""


VIDEO_FORMS = "test, v4l2:/dev/NAME, rtsp://HOST/PATH without a password, or a file such as plant.mp4"
_VIDEO = re.compile(r"test|v4l2:/dev/[A-Za-z0-9_/-]+|rtsps?://[^\s@/]+(/[^\s@]*)?|[^:@\s]+\.[A-Za-z0-9]+")


def _names_video(text: str) -> str:
    if not _VIDEO.fullmatch(text):
        raise PydanticCustomError("video", "should be {pattern}", {"pattern": VIDEO_FORMS})
    return text


VideoSource = Annotated[str, AfterValidator(_names_video)]


class DescriptionModel(BaseModel):
    """Base: immutable, and a field that is not known is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Pose(DescriptionModel):
    """A pose by position and roll, pitch, yaw: `R = Rz(yaw) Ry(pitch) Rx(roll)`."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    """x, y, z."""
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw."""


class BoxShape(DescriptionModel):
    """A box, its frame at its centre."""

    kind: Literal["box"]
    size_m: tuple[Positive, Positive, Positive]
    """Edges along x, y and z."""


class CylinderShape(DescriptionModel):
    """A cylinder along z, its frame at its centre."""

    kind: Literal["cylinder"]
    radius_m: Positive
    length_m: Positive


class CapsuleShape(DescriptionModel):
    """A cylinder along z with round ends, its frame at its centre; the length excludes the ends."""

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
    """What the gate measures; a figure shows the same."""
    pose: Pose = Pose()
    colour_rgba: Colour = (0.6, 0.6, 0.62, 1.0)
    """In figures: red, green, blue and opacity, each from 0 to 1."""


class Attachment(Body):
    """A body bolted to a link of a robot, e.g. a control box or a camera housing."""

    link: str
    """Name of the link in the URDF."""


class Camera(DescriptionModel):
    """A camera in the flange frame; its z axis is the view axis, its x axis points up in the picture.

    A stereo camera has an eye on either side of that frame, along its y axis.
    """

    pose: Pose = Pose()
    vertical_view_deg: Annotated[float, Field(gt=1, lt=170)] = 45.0
    """Angle of view along the picture's x axis."""
    aspect: Annotated[float, Field(gt=0.1, lt=10)] = 1.5
    """Width of a picture by its height."""
    baseline_m: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Distance between the eyes of a stereo camera; 0 for a single one."""
    source: VideoSource | None = None
    """Its live picture: `test`, `v4l2:/dev/video0`, `rtsp://HOST/PATH`, or a file beside the cell's; none: it has none.
    Clients can read it, so it has no password: the environment variable DELTAQ_VIDEO_LOGIN gives `USER:PASSWORD`."""
    source_right: VideoSource | None = None
    """The same of the right eye of a stereo camera; `source` is then that of the left eye."""

    @property
    def eyes(self) -> dict[str, str]:
        """The sources of its live pictures by the ends of their names: that of the right eye is `.right`."""
        given = {"": self.source, ".right": self.source_right}
        return {end: source for end, source in given.items() if source is not None}

    @model_validator(mode="after")
    def _has_a_source_for_either_eye(self) -> Self:
        if self.source_right is not None and (self.source is None or not self.baseline_m):
            raise ValueError(
                f"source_right is {self.source_right}, and source {self.source or 'none'} with baseline_m "
                f"{self.baseline_m:g}: a right eye needs a source of the left one, and baseline_m above 0"
            )
        return self


class Tool(DescriptionModel):
    """Tool frame and bodies of the tool, both in the flange frame."""

    frame: Pose = Pose()
    """Its z axis points out of the tool."""
    bodies: dict[Name, Body] = {}


class ExchangeableTool(Tool):
    """A tool that a tool changer couples; its bodies are named `gr/valve_key_shaft`."""

    mass_kg: NotNegative = 0.0
    """At the origin of its frame, for criteria that weigh the arm; the KRC has load data of its own."""


class ToolChanger(DescriptionModel):
    """A tool changer behind digital signals of its robot; its output rests at off: no failure drops a tool."""

    release: Name
    """Output that opens it while on, and locks while off; only a request for a tool switches it."""
    locked: Name
    """Input that is on while a tool is locked."""
    within_s: Positive = 2.0
    """Time from a request until the input has to confirm it."""


class Hand(Tool):
    """One of several hands: a tool on its own link, with frame and bodies in the frame of that link."""

    link: str
    """Name of the link in the URDF."""
