"""What all messages share: their base, and the types of their fields."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

PROTOCOL_VERSION = 3
LINE_VERSIONS = (1, 2, 3)
"""Versions that clients over lines of JSON may speak: to them later ones have only more fields to pass over."""

MOST = 1e30
"""Greatest number in a message: its square or a rate computed from it cannot overflow."""
MOST_OF_A_JOINT = 1e6
"""Greatest position, increment, speed or acceleration of a joint in a message [rad or m, per s, per s^2]; so far from
the origin may a point be [m], too."""
Real = Annotated[float, Field(allow_inf_nan=False, ge=-MOST, le=MOST)]
JointValue = Annotated[
    float, Field(strict=True, allow_inf_nan=False, ge=-MOST_OF_A_JOINT, le=MOST_OF_A_JOINT)
]
Joints = Annotated[tuple[JointValue, ...], Field(min_length=1, max_length=32)]
_Part = Annotated[float, Field(allow_inf_nan=False, ge=-MOST_OF_A_JOINT, le=MOST_OF_A_JOINT)]
Vector3 = tuple[_Part, _Part, _Part]
Quaternion = tuple[_Part, _Part, _Part, _Part]
Row = tuple[_Part, _Part, _Part, _Part]
PoseRows = tuple[Row, Row, Row, Row]
"""A homogeneous matrix, row by row."""
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[a-z][a-z0-9_-]*$")]
ToolName = Annotated[str, Field(max_length=64, pattern=r"^([a-z][a-z0-9_-]*)?$")]
"""An exchangeable tool of a robot; empty: none."""
Count = Annotated[int, Field(ge=0, lt=2**63)]
MOST_COUNTED_ON = 2**62
"""Upper bound of ids and epochs that a receiver continues to count: no message can exhaust the count."""
Secret = Annotated[str | None, Field(repr=False)]
"""A token: neither shown nor quoted, see `deltaq_protocol.codec`."""


class Message(BaseModel):
    """Base of all messages: immutable, and an unknown field is an error.

    Neither its errors nor its `repr` show what may be a secret.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)
