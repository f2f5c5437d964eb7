"""Process equipment: which bodies of the structure belong to it, and how a robot works on it."""

from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, model_validator

from deltaq_cell.description.bodies import DescriptionModel, NotNegative, Pose, Positive
from deltaq_protocol.messages import Name

EquipmentKind = Literal["valve", "lever", "gauge", "inspection_point", "tool_stand"]

_NEEDS: dict[str, tuple[str, ...]] = {
    "valve": ("approach", "axis", "turns", "reach_m", "contact"),
    "lever": ("approach", "reach_m", "stroke_m", "contact"),
    "gauge": (),
    "inspection_point": ("approach", "reach_m", "contact"),
    "tool_stand": ("approach",),
}
"""Fields that the kinds of equipment cannot do without."""
_EXAMPLES = {
    "approach": "{position_m: [0, 0, 1], rpy_deg: [180, 0, 0]}",
    "axis": "[0, 0, 1]",
    "turns": "2",
    "reach_m": "0.12",
    "stroke_m": "0.02",
    "contact": "the name of a contact of the cell",
}

AxisDirection = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class EquipmentDescription(DescriptionModel):
    """One item of equipment. It adds no body and changes no decision of the gate: routines and people read it."""

    kind: EquipmentKind
    bodies: Annotated[tuple[Name, ...], Field(min_length=1)]
    """Bodies of the structure that belong to it; cameras look at the first."""
    robot: Name | None = None
    """The robot that works on it; none: the one that the cell's camera watches."""
    approach: Pose | None = None
    """Pose of that robot's tool in front of it, clear of all bodies; the tool's z axis points at it."""
    reach_m: NotNegative | None = None
    """Way of the tool from there, along its z axis, until it touches or grips."""
    contact: Name | None = None
    """The contact of the cell that lets the tool touch it."""
    tool: Name | None = None
    """Exchangeable tool that a stand holds, or with which others are worked on. In front of a stand `approach` is the
    pose of the bare changer."""
    axis: AxisDirection | None = None
    """Of a valve: direction of its spindle, which passes the centre of the first body."""
    turns: Positive | None = None
    """Of a valve: full turns from one end to the other."""
    stroke_m: Positive | None = None
    """Of a lever: how far it is pressed."""
    view_m: Annotated[float, Field(ge=0.2, le=4.0)] = 1.25
    """Distance from which a camera looks at it."""

    @model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Self:
        for field in _NEEDS[self.kind]:
            if getattr(self, field) is None:
                raise ValueError(f"a {self.kind} needs {field}, such as {field}: {_EXAMPLES[field]}")
        if self.axis is not None and not any(self.axis):
            raise ValueError("axis is no direction, all three elements are 0; write [0, 0, 1] for upwards")
        return self


__all__ = ["EquipmentDescription", "EquipmentKind"]
