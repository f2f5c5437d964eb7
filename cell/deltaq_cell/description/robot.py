"""One robot of a cell."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from deltaq_cell.description.base import DescriptionModel, GuardedEndpointText, JointName, Pose
from deltaq_cell.description.bodies import Attachment, Camera, Hand, Tool
from deltaq_cell.description.driver import DRIVES, Driver, RsiDescription, ServoLag
from deltaq_cell.description.joint import JointDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Name


class RobotDescription(DescriptionModel):
    """One robot of the cell."""

    model: str
    """A model's name (`kr16`), the path of a URDF file, or `package://` and a path within a package."""
    server: GuardedEndpointText
    """Endpoint at which its Robot Server listens for SIM and HLI."""
    driver: Driver
    joints: Annotated[dict[JointName, JointDescription], Field(min_length=1)]
    """In the joint order of the model."""
    locked_joints: dict[JointName, FiniteFloat] = {}
    """Joints that this cell holds still, for example a gripper's, and where: in rad or m, as in the URDF."""
    base: Pose = Pose()
    tool: Tool = Tool()
    hands: dict[Name, Hand] = {}
    """Of a robot with several; a single tool pose is that of the first. Such a robot has no `tool`."""
    camera: Camera | None = None
    attachments: dict[Name, Attachment] = {}
    mounted_on: tuple[str, ...] = ()
    """Bodies of the structure that the robot's base stands on or hangs from; never checked against it."""
    never_checked: tuple[tuple[str, str], ...] = ()
    """Links or bodies of the robot that cannot touch, or always do; `deltaq check` lists the pairs left out and why."""
    servo_lag: ServoLag = ServoLag()
    """Lag of the emulated drives; of a robot on RSI that does not say it, that of its generation of KRC."""
    outputs: tuple[Name, ...] = ()
    inputs: tuple[Name, ...] = ()

    @model_validator(mode="after")
    def _lags_as_its_krc(self) -> Self:
        if isinstance(self.driver, RsiDescription) and "servo_lag" not in self.model_fields_set:
            self.__dict__["servo_lag"] = DRIVES[self.driver.krc]  # no field of a frozen model can be set
        return self

    @model_validator(mode="after")
    def _has_a_tag_for_every_signal(self) -> Self:
        if isinstance(self.driver, RsiDescription):
            for kind, names in (("inputs", self.inputs), ("outputs", self.outputs)):
                tags: dict[str, str] = getattr(self.driver, kind)
                if set(names) != set(tags):
                    example = f"{next(iter(names), 'name')}: {'Di.I1' if kind == 'inputs' else 'Do.O1'}"
                    raise ValueError(
                        f"{kind} names {', '.join(names) or 'none'}, and driver.{kind} gives a TAG of the KRC's file "
                        f"for {', '.join(tags) or 'none'}; give one for each, such as {kind}: {{{example}}}"
                    )
        return self

    @model_validator(mode="after")
    def _carries_tools_in_one_place(self) -> Self:
        if self.hands and "tool" in self.model_fields_set:
            raise ValueError("a robot with hands carries its tools there: leave out tool")
        taken = {"tool", "camera", "object"} & set(self.hands)
        if taken:
            raise ValueError(f"a hand cannot be named {' or '.join(sorted(taken))}; name it otherwise")
        return self

    def _vector(self, attribute: str) -> Array:
        vector = np.array([getattr(joint, attribute) for joint in self.joints.values()])
        vector.flags.writeable = False
        return vector

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(self.joints)

    @cached_property
    def units(self) -> tuple[Literal["rad", "m"], ...]:
        """Unit of each joint."""
        return tuple("rad" if joint.revolute else "m" for joint in self.joints.values())

    @cached_property
    def home(self) -> Array:
        """(n,) home configuration [rad or m]."""
        return self._vector("home")

    @cached_property
    def lower(self) -> Array:
        """(n,) lower limits [rad or m]."""
        return self._vector("lower")

    @cached_property
    def upper(self) -> Array:
        """(n,) upper limits [rad or m]."""
        return self._vector("upper")

    @cached_property
    def max_velocity(self) -> Array:
        """(n,) largest speeds [rad/s or m/s]."""
        return self._vector("max_velocity")

    @cached_property
    def max_acceleration(self) -> Array:
        """(n,) largest accelerations [rad/s^2 or m/s^2]."""
        return self._vector("max_acceleration")

    @cached_property
    def tracking_tolerance(self) -> Array:
        """(n,) how far measured joints may be off the commanded path [rad or m]."""
        return self._vector("tracking_tolerance")
