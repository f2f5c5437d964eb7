"""The interface of a mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.modes.held_object import HeldObject
from deltaq_controllers.modes.limitation import Limitation
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_controllers.surroundings.surroundings import RobotSurroundings
from deltaq_protocol.arrays import Array


@dataclass(frozen=True)
class Instant:
    """A robot's configuration in a cycle, and the bounds of its next increment.

    Attributes:
        q_cmd: (n,) setpoint that the increment is added to [rad or m].
        dq_last: (n,) increment that led to it [rad or m].
        dq_before: (n,) the one before that [rad or m].
        limits: of the increments.
        max_jerk: (n,) greatest change of an increment's change; infinite for no limit [rad or m].
        cycle_s: the cycle [s].
        surroundings: what the robot keeps clear of by itself; None leaves that to the gate.
        held: the object that the hands keep between them; None for hands that are free.
    """

    q_cmd: Array
    dq_last: Array
    dq_before: Array
    limits: IncrementLimits
    max_jerk: Array
    cycle_s: float
    surroundings: RobotSurroundings | None = None
    held: HeldObject | None = None


class Advance(NamedTuple):
    """An increment, and what keeps it from the requested one.

    Attributes:
        dq: (n,) increment [rad or m].
        limitation: what limits the operator; None if nothing does.
    """

    dq: Array
    limitation: Limitation | None = None


class TeleoperationMode(Protocol):
    """Turns a motion of joints and hands into joint displacements.

    Attributes:
        drives_joints: (n,) which joints an operator drives by name.
    """

    drives_joints: NDArray[np.bool_]

    @property
    def name(self) -> ModeName:
        """As in `--mode`."""
        ...

    @property
    def drives_hands(self) -> bool:
        """Whether an operator drives the hands."""
        ...

    @property
    def status(self) -> str:
        """Status for the operator, beside what limits the mode."""
        return ""

    @property
    def arrived_at(self) -> int | None:
        """The option that the robot stands at."""
        return None

    @property
    def awaits_advice(self) -> bool:
        """Whether the option that was chosen is still being looked for, or a path to it."""
        return False

    def stand_in(self) -> TeleoperationMode:
        """The mode that `practise` runs in place of this one; itself, unless it would start work elsewhere."""
        return self

    def enter(self, q: Array) -> None:
        """The robot stands at `q` (n,) and this mode takes over."""
        del q

    def leave(self) -> None:
        """Another mode takes over."""
        return

    def choose(self, option: int | None) -> None:
        """Set the option that is commanded in this cycle."""
        del option

    def advance(self, instant: Instant, asked: Motion, /) -> Advance:
        """The increment of this cycle towards a motion that is asked for; zero at rest and for no motion."""
        ...
