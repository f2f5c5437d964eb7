"""The options that all experiments of `deltaq experiment` share."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

from deltaq_controllers.camera import FOLLOWS
from deltaq_controllers.leader.scripted import STICK_ACCELERATION_M_S2
from deltaq_protocol.messages.motion import AIM_M


@dataclass(frozen=True)
class Options:
    """Options of one run.

    Attributes:
        cell: name or file of a cell in which a robot with a camera can watch another one.
        controller: name of the camera controller, or `package.module:function` of one's own.
        robot: the robot with the camera; None for the cell's first.
        leader: the watched robot; None for the first other one, preferably one without a camera.
        leader_speed_m_s: requested speed of the leader's tool.
        stick_m_s2: largest requested acceleration of the leader's tool.
        latency_s: delay of the leader's states on the link to the camera's controller, in whole cycles. It is added
            to the loop's own latency: the drives' lag and three cycles.
        duration_s: length of the run; None for the experiment's own.
        seed: determines the run.
        settle_s: initial time that rms and max leave out.
        live: real processes, zenoh and UDP.
        target: the target of a collision's attacks; other experiments do not use it.
        aim_offset_m: watched point of the leader's tool, in the tool's frame; a collision does not use it.
        gated: whether a gate stops the robots; without one a collision shows the follower alone.
        record: MCAP file to record to; of several runs in one experiment the later ones are numbered.
    """

    cell: str | Path = "lab"
    controller: str = FOLLOWS
    robot: str | None = None
    leader: str | None = None
    leader_speed_m_s: float = 0.25
    stick_m_s2: float = STICK_ACCELERATION_M_S2
    latency_s: float = 0.0
    duration_s: float | None = None
    seed: int = 0
    settle_s: float = 5.0
    live: bool = False
    target: str = "lens"
    aim_offset_m: tuple[float, float, float] = AIM_M
    gated: bool = True
    record: Path | None = None

    def lasting(self, default_s: float) -> Self:
        """The options with `duration_s` filled in."""
        return self if self.duration_s is not None else replace(self, duration_s=default_s)

    @property
    def length_s(self) -> float:
        """`duration_s`, once it has been filled in."""
        assert self.duration_s is not None  # every experiment begins with `lasting`
        return self.duration_s
