"""The description of a cell: robots, structure, gate."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from deltaq_cell.description.bodies import (
    LOCAL,
    Body,
    DescriptionModel,
    EndpointText,
    GuardedEndpointText,
    NotNegative,
    Positive,
)
from deltaq_cell.description.equipment import EquipmentDescription
from deltaq_cell.description.robot import RobotDescription
from deltaq_protocol.messages import Name

MOST_ROBOTS = 8
"""In one cell: one thread decides for all, and the number of pairs grows with the square."""


class ContactDescription(DescriptionModel):
    """Bodies that may touch while an operator allows it, for example a gripper and its valve.

    Meanwhile the gate does not keep these pairs apart, and every robot that they belong to moves slowly.
    """

    bodies: Annotated[list[str], Field(min_length=1)]
    """Names of bodies of robots, such as gr/tool_finger_1."""
    against: Annotated[list[str], Field(min_length=1)]
    """Names of the bodies that they may touch, such as structure/valve_1."""
    speed: Annotated[float, Field(gt=0, le=1)] = 0.05
    """Fraction of the velocity limits that applies to the robots meanwhile."""

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Every body with every one that it may touch."""
        return [(one, other) for one in self.bodies for other in self.against]

    def concerns(self, robot: str) -> bool:
        """Whether a body of that robot is among them."""
        return any(name.startswith(f"{robot}/") for name in (*self.bodies, *self.against))


MOST_LOOKAHEAD_CYCLES = 8
"""Greatest lookahead: the gate certifies one trajectory for each admission in flight."""


class GateDescription(DescriptionModel):
    """The margins of the gate.

    The timeouts only give a loss its name: the brake begins in the first cycle without a fresh admission.
    """

    stop_distance_m: Positive = 0.05
    """Bodies of different robots, and robot and structure, never come nearer than this."""
    self_stop_distance_m: Positive = 0.02
    """Two bodies of one robot never come nearer than this."""
    slow_down_distance_m: Positive | None = None
    """Below this distance, the nearer two bodies are, the slower they approach; none: no such limit."""
    slow_down_speed_m_s: Positive = 0.25
    """Approach speed that is allowed at that distance; it falls to zero at the stop distance."""
    servo_lag_s: Positive = 0.204
    """How long the drives may still travel a setpoint, from its sending. On a KR 16 with a KR C2 95 % of a step arrive
    within .189 s; a cycle is added."""
    servo_lag_spread_s: NotNegative = 0.012
    """Greatest difference between the lags of two joints of one robot."""
    retreat_speed: Annotated[float, Field(gt=0, le=1)] = 0.1
    """Fraction of the velocity limits that is allowed while leaving a violation."""
    max_request_age_s: Positive = 0.12
    """An increment that answers an older state is stale, and one older than the table of topics allows."""
    lookahead_cycles: Annotated[int, Field(ge=1, le=MOST_LOOKAHEAD_CYCLES)] = 1
    """How many setpoints may be decided that are not sent yet; more leave more time for answers."""
    gate_timeout_s: Positive = 0.5
    """Silence after which a Robot Server takes the gate for lost."""
    hli_timeout_s: Positive = 0.5
    """Silence after which the gate takes the HLI for lost."""
    krc_timeout_s: Positive = 0.25
    """Silence after which a Robot Server takes its KRC for lost."""

    @model_validator(mode="after")
    def _slows_down_before_it_stops(self) -> Self:
        stop = max(self.stop_distance_m, self.self_stop_distance_m)
        if self.slow_down_distance_m is not None and self.slow_down_distance_m <= stop:
            raise ValueError(
                f"slow_down_distance_m is {self.slow_down_distance_m:g}, which has to be more than the stop "
                f"distances, {stop:g}"
            )
        return self


class CellDescription(DescriptionModel):
    """A cell: its robots, its structure, the gate's margins, and the addresses of its services."""

    cell: Name
    """Its name."""
    cycle_s: Annotated[float, Field(ge=0.001, le=0.1)]
    """The robots' own sample time."""
    robots: Annotated[dict[Name, RobotDescription], Field(min_length=1, max_length=MOST_ROBOTS)]
    """By name."""
    structure: dict[Name, Body] = {}
    """Fixed bodies, in the world's frame."""
    gate: GateDescription = GateDescription()
    contacts: dict[Name, ContactDescription] = {}
    """Contacts that an operator may allow; none is allowed at the start."""
    equipment: dict[Name, EquipmentDescription] = {}
    """Valves, gauges and the like that routines work on."""
    hli: EndpointText = "tcp/127.0.0.1:7447"
    """Where the HLI serves zenoh clients; with `tcp+udp` streams go over UDP, for networks that lose packets; with
    `tls` it is encrypted, and only clients with an identity of the cell can connect."""
    sim: GuardedEndpointText = LOCAL
    """Where the SIM listens in the guarded realm: on this machine, or at `tls/HOST:PORT`."""
    tcp_address: str = "127.0.0.1"
    tcp_port: Annotated[int, Field(ge=1, le=65535)] = 5210
    """Where the HLI serves JSON lines."""
    clients_need_tokens: bool = False
    """Whether the HLI starts only with an operator's and a controller's token, and only clients with a token may
    move a robot.
    """
    anyone_who_connects_may_move_the_robots: bool = False
    """Whether the HLI may listen on other addresses than this machine's loopback though clients need no tokens."""
    console_address: str = "127.0.0.1"
    console_port: Annotated[int, Field(ge=1, le=65535)] = 7480
    """Where the console serves browsers."""
    lease_s: Positive = 1.0
    """How long a lease lasts while its holder is silent; any message of the holder renews it."""
    max_playout_s: Annotated[float, Field(gt=0, le=5)] = 1.0
    """How long an increment may be under way and wait for its turn, where a lease asks for a jitter buffer."""
