"""What may drive a robot in a test, as a function from a state to an increment."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Protocol, runtime_checkable

from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import RobotState
from deltaq_testing.faults.controller import Decide


class CellUseError(DeltaqError):
    """The cell under test is asked for what it cannot do: run undriven, be driven twice, have a seed below zero."""


@runtime_checkable
class Viewing(Protocol):
    """A controller as `deltaq_controllers.interface.Controller` has it."""

    def increment(self, view: View) -> Array:
        """The increment (n,) for this cycle [rad or m]."""
        ...


def begun(controller: Any) -> Any:
    """What a process of it runs: an object of a class, or what was given."""
    return controller() if isinstance(controller, type) else controller


def deciding(controller: Any, states: Mapping[str, RobotState]) -> Decide:
    """The function that is asked.

    Args:
        controller: a function of a state, or what has a method `increment(view)`.
        states: the newest of each robot.

    Raises:
        CellUseError: it is neither.
    """
    if isinstance(controller, Viewing):
        return partial(_viewed, controller, states)
    if callable(controller):
        decide: Decide = controller
        return decide
    raise CellUseError(
        f"a controller is a function of a state, or has a method increment(view); got {type(controller).__name__}"
    )


def _viewed(controller: Viewing, states: Mapping[str, RobotState], state: RobotState) -> Array:
    others = {name: RobotView.from_state(one) for name, one in states.items() if name != state.robot}
    return controller.increment(View(RobotView.from_state(state), others))
