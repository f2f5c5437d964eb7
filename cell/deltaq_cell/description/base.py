"""Base of all parts of a cell's description, and the types of their fields."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from deltaq_protocol.messages import Vector3

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
JointName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z_][A-Za-z0-9_.-]*$")]
"""As its URDF names it."""
EndpointText = Annotated[str, Field(pattern=r"^(tcp|tcp\+udp|tls)/[^/\s]+:\d{1,5}$")]
"""Of the open realm; `tcp+udp` where the network loses packets, `tls` where clients have identities."""
GuardedEndpointText = Annotated[str, Field(pattern=r"^(tcp|tls)/[^/\s]+:\d{1,5}$")]
"""Of the guarded realm; `tls` where its services have identities."""


class DescriptionModel(BaseModel):
    """Base: immutable, and a field that is not known is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Pose(DescriptionModel):
    """A pose by position and roll, pitch, yaw: `R = Rz(yaw) Ry(pitch) Rx(roll)`."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)
