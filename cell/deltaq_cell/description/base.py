"""Base of all parts of a cell's description, and the types of their fields."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from deltaq_protocol.endpoint import Endpoint, InvalidEndpointError
from deltaq_protocol.messages import Vector3


def _listens_over(transports: tuple[str, ...], text: str) -> str:
    try:
        is_one = Endpoint.parse(text).transport in transports
    except InvalidEndpointError:
        is_one = False
    if not is_one:
        *most, last = (f"{transport}/HOST:PORT" for transport in transports)
        forms = {"pattern": f"{', '.join(most)} or {last}"}
        raise PydanticCustomError("endpoint", "should be {pattern}, with a port of 1 to 65535", forms)
    return text


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
JointName = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z_][A-Za-z0-9_.-]*$")]
"""As its URDF names it."""
EndpointText = Annotated[str, AfterValidator(partial(_listens_over, ("tcp", "tcp+udp", "tls")))]
"""Of the open realm; `tcp+udp` where the network loses packets, `tls` where clients have identities."""
GuardedEndpointText = Annotated[str, AfterValidator(partial(_listens_over, ("tcp", "tls")))]
"""Of the guarded realm; `tls` where its services have identities."""


class DescriptionModel(BaseModel):
    """Base: immutable, and a field that is not known is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Pose(DescriptionModel):
    """A pose by position and roll, pitch, yaw: `R = Rz(yaw) Ry(pitch) Rx(roll)`."""

    position_m: Vector3 = (0.0, 0.0, 0.0)
    rpy_deg: Vector3 = (0.0, 0.0, 0.0)
