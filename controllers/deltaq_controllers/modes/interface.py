"""What a mode is."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from deltaq_controllers.modes.limitation import Limitation
from deltaq_controllers.modes.motion import ModeName, Motion
from deltaq_protocol.arrays import Array


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

    def bounded(self, q: Array, motion: Motion, /) -> Motion:
        """The motion, slowed as far as this mode's guarantee requires at `q` (n,)."""
        del q
        return motion

    def step(self, q: Array, motion: Motion, time_s: float, /) -> Array:
        """The joint displacement (n,) for a motion over a time from `q` (n,); zero for no motion."""
        ...

    def limitation(self, q: Array, motion: Motion, /) -> Limitation | None:
        """The limit of the robot's geometry that this motion meets at `q` (n,)."""
        ...
