"""How a Robot Server reaches its robot."""

from __future__ import annotations

from ipaddress import ip_address
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from deltaq_cell.description.base import DescriptionModel, NotNegative, Positive
from deltaq_protocol.messages import Name


def _is_loopback(address: str) -> bool:
    try:
        return ip_address(address).is_loopback
    except ValueError:  # a name
        return address == "localhost"


class RsiDescription(DescriptionModel):
    """A KUKA controller reached over RSI: the Robot Server listens on `address:port`, the KRC sends to it."""

    kind: Literal["rsi"]
    address: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)]
    krc_address: str | None = None
    """The KRC's own address: datagrams from others are dropped. Needed unless `address` is a loopback."""
    ethernet_xml: str
    """The RSI configuration that the KRC has loaded, beside the cell's file or shipped."""
    krc: Literal["krc2", "krc4"] = "krc2"
    ipoc_step: Annotated[int, Field(ge=1, le=1000)] | None = None
    """By how much the KRC's IPOC grows in a cycle; none: learned from its first telegrams."""
    inputs: dict[Name, str] = {}
    """Per digital input of the robot the TAG of the BOOL of SEND that carries it, such as Di.I1."""
    outputs: dict[Name, str] = {}
    """Per digital output of the robot the TAG of the BOOL of RECEIVE that carries it, such as Do.O1."""
    stop: str | None = None
    """TAG of the BOOL of RECEIVE that ends the motion on the KRC's side, such as Stop; none if it has none."""
    max_correction_deg: Positive | None = None
    """Largest correction sent to a rotating axis; none: as far as the joint limits, and a margin, allow."""
    max_correction_mm: Positive | None = None
    """The same for a linear axis."""
    control_port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """The emulator's operator panel listens here; a real KRC has none. Best a port that the system gives to no socket
    that asks for none: on Linux one below 32768."""

    @model_validator(mode="after")
    def _listens_to_one_krc(self) -> Self:
        if self.krc_address is None and not _is_loopback(self.address):
            raise ValueError(
                f"krc_address is not given though address is {self.address}: whoever reaches that address could "
                "pass for the KRC; give the KRC's own address, such as krc_address: 192.168.10.20"
            )
        return self

    @model_validator(mode="after")
    def _keeps_stop_from_users(self) -> Self:
        for name, tag in self.outputs.items():
            if tag == self.stop:
                raise ValueError(
                    f"outputs.{name} is {tag}, which is driver.stop: users set outputs, and the Robot Server "
                    "alone ends the motion; give the output another BOOL of RECEIVE"
                )
        return self


class KinematicDriver(DescriptionModel):
    """A robot that is no KUKA: the Robot Server itself keeps the time, and measured joints equal the setpoint."""

    kind: Literal["kinematic"]


Driver = Annotated[RsiDescription | KinematicDriver, Field(discriminator="kind")]


class ServoLag(DescriptionModel):
    """The drives' lag from command to motion, as the emulator models it: dead time and second order."""

    dead_time_s: NotNegative = 0.012
    natural_frequency_rad_s: Positive = 167.0
    damping: Positive = 1.0


DRIVES = {
    "krc2": ServoLag(dead_time_s=0.046, natural_frequency_rad_s=40.0),
    "krc4": ServoLag(dead_time_s=0.016, natural_frequency_rad_s=40.0),
}
"""Lag of emulated drives by generation of the KRC, where a robot says none.

Of a KR 16 on a KR C2 a response of 50 ms and a tracking delay over RSI of 120 ms are published (Arbo, Eriksen,
Sanfilippo, Gravdahl: Comparison of KVP and RSI for controlling KUKA robots over ROS, IFAC-PapersOnLine 53-2, 2020,
9841-9846): two cycles of 12 ms until a setpoint reaches the drives, 46 ms of dead time, and a second order of 2 / 40 s.
For a KR C4 nothing is published: the same response, and a dead time of as many cycles, a stand-in until
`deltaq krc lag` has measured it."""
