"""The description of a cell, as its YAML file gives it.

Field names carry their unit. People read and write degrees here; `JointDescription` and everything
behind it returns rad and m. The numbers of a robot in joint order come from `RobotDescription.lower` and
its siblings.
"""

from deltaq_cell.description.bodies import (
    LOCAL,
    Attachment,
    Body,
    BoxShape,
    Camera,
    CapsuleShape,
    Colour,
    CylinderShape,
    DescriptionModel,
    EndpointText,
    ExchangeableTool,
    GuardedEndpointText,
    Hand,
    JointName,
    NotNegative,
    Pose,
    Positive,
    Shape,
    SphereShape,
    Tool,
    ToolChanger,
)
from deltaq_cell.description.cell import MOST_ROBOTS, CellDescription, ContactDescription, GateDescription
from deltaq_cell.description.equipment import EquipmentDescription, EquipmentKind
from deltaq_cell.description.robot import (
    DriverDescription,
    JointDescription,
    KinematicDriver,
    RobotDescription,
    RsiDescription,
    ServoLag,
)
from deltaq_protocol.messages import Name, Vector3

__all__ = [
    "LOCAL",
    "MOST_ROBOTS",
    "Attachment",
    "Body",
    "BoxShape",
    "Camera",
    "CapsuleShape",
    "CellDescription",
    "Colour",
    "ContactDescription",
    "CylinderShape",
    "DescriptionModel",
    "DriverDescription",
    "EndpointText",
    "EquipmentDescription",
    "EquipmentKind",
    "ExchangeableTool",
    "GateDescription",
    "GuardedEndpointText",
    "Hand",
    "JointDescription",
    "JointName",
    "KinematicDriver",
    "Name",
    "NotNegative",
    "Pose",
    "Positive",
    "RobotDescription",
    "RsiDescription",
    "ServoLag",
    "Shape",
    "SphereShape",
    "Tool",
    "ToolChanger",
    "Vector3",
]
