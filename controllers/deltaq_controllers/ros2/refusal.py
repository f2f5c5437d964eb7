"""The refusal of a ROS message: one line that names field, value and bound."""

from __future__ import annotations

from deltaq_protocol.errors import DeltaqError


class RefusedMessageError(DeltaqError):
    """A message that is not acted upon.

    Attributes:
        field: where in the message, e.g. `points[2].velocities`.
        why: a name under which refusals of this kind are counted.
    """

    def __init__(self, why: str, field: str, value: object, bound: str) -> None:
        super().__init__(f"{field} is {value}, allowed is {bound}")
        self.why = why
        self.field = field
