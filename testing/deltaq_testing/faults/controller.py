"""A controller in virtual time: a function that returns increments, and its misbehaviour under faults."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np

from deltaq_controllers.interface import RobotView, View
from deltaq_protocol.arrays import Array
from deltaq_protocol.codec import InvalidMessageError, from_map
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import (
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    RobotState,
    Verdict,
)
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.faults.catalogue import Misbehaviour
from deltaq_testing.virtual_cell.clients import Say

Decide = Callable[[RobotState], Array | Sequence[float] | None]
"""The increment (n,) [rad or m] in answer to a state; None leaves the state unanswered."""

_FLOOD = 20
_LEAP_RAD = 1.0
_RETRY_CYCLES = 8


class VirtualController:
    """Answers the states of one robot, and asks for its lease whenever it has none.

    Args:
        robot: its name.
        decide: returns each increment.
        send: sends its messages to the HLI.
        client: its own name.
        told: gets all messages of the HLI.

    Attributes:
        robot: its name.
        token: of the lease; None without one.
        misbehaviour: None while it behaves.
    """

    def __init__(
        self,
        robot: str,
        decide: Decide,
        send: Say,
        client: str = "mover",
        told: Callable[[Message], None] = lambda _: None,
    ) -> None:
        self.robot = robot
        self.token: str | None = None
        self.misbehaviour: Misbehaviour | None = None
        self._decide, self._send, self._client = decide, send, client
        self._told = told
        self._seq = 0
        self._asked_cycle = -_RETRY_CYCLES

    def take(self, message: Message) -> None:
        """Take a message of the HLI, and answer it."""
        self._told(message)
        if isinstance(message, LeaseReply):
            # one that was refused may answer a request that was overtaken by the one that was granted
            self.token = message.lease if message.granted else self.token
        elif isinstance(message, Verdict) and message.robot == self.robot:
            if any(reason.code is ReasonCode.LEASE_NOT_HELD for reason in message.reasons):
                self.token = None
        elif isinstance(message, RobotState) and message.robot == self.robot:
            self._on_state(message)

    def _on_state(self, state: RobotState) -> None:
        if self.token is None:
            # a Robot Server that restarts counts its cycles from one
            if abs(state.cycle - self._asked_cycle) >= _RETRY_CYCLES:
                self._asked_cycle = state.cycle
                self._send(LeaseRequest(robot=self.robot, action=LeaseAction.ACQUIRE, client=self._client))
            return
        dq = self._decide(state)
        if dq is None:
            return
        for asked in misbehaved(self.misbehaviour, state.cycle, plain(dq)):
            self._seq += 1
            data = {"robot": self.robot, "seq": self._seq, "cycle": state.cycle, "dq": asked}
            self._send(increment_of(data, self.token))


def misbehaved(how: Misbehaviour | None, cycle: int, dq: Any) -> Iterator[Any]:
    """The values sent in place of an increment (n,) [rad or m] under a misbehaviour."""
    match how:
        case Misbehaviour.EVERY_FOURTH if cycle % 4:
            return
        case Misbehaviour.NAN_FLOOD:
            for _ in range(_FLOOD):
                yield [float("nan")] * len(dq)
        case Misbehaviour.LEAP:
            yield (np.sign(dq) * _LEAP_RAD).tolist()
        case _:
            yield dq


def increment_of(data: dict[str, Any], token: str | None) -> Increment | InvalidMessageError:
    """The increment in a message, or why the HLI finds none in it; `token` is that of the lease."""
    try:
        return from_map(Increment, {**data, "type": "increment", "lease": token})
    except InvalidMessageError as error:
        return error


def plain(dq: Any) -> Any:
    """A controller's result in the form of a message, unchecked: the HLI checks it."""
    if isinstance(dq, np.ndarray):
        return dq.tolist()
    return (
        [float(one) if isinstance(one, np.number) else one for one in dq] if isinstance(dq, Iterable) else dq
    )


class CellUseError(DeltaqError):
    """Impossible use of the cell under test: run undriven, driven twice, or with a seed below zero."""


@runtime_checkable
class Viewing(Protocol):
    """A controller as `deltaq_controllers.interface.Controller` has it."""

    def increment(self, view: View) -> Array:
        """The increment (n,) for this cycle [rad or m]."""
        ...


def begun(controller: Any) -> Any:
    """The controller of a new process: a new object of a class, or the given object."""
    return controller() if isinstance(controller, type) else controller


def deciding(controller: Any, states: Mapping[str, RobotState]) -> Decide:
    """The function that returns increments.

    Args:
        controller: a function of a state, or an object with a method `increment(view)`.
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
