"""The moving controller in virtual time, and what it does when it goes wrong."""

from __future__ import annotations

import numpy as np

from deltaq_protocol.codec import InvalidMessageError, from_map
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
from deltaq_verification.faults.actions import Misbehaviour
from deltaq_verification.faults.mover import Mover
from deltaq_verification.virtual_cell.clients import Say

_FLOOD = 20
_LEAP_RAD = 1.0
_RETRY_CYCLES = 8


class VirtualController:
    """Answers the states of one robot, and asks for its lease whenever it has none.

    Args:
        robot: its name.
        joints: number of its joints.
        cycle_s: its sample time.
        home: position of its first joint at home [rad].
        send: puts what it says on the wire to the HLI.

    Attributes:
        robot: its name.
        token: of the lease; None without one.
        misbehaviour: None while it behaves.
    """

    def __init__(
        self,
        robot: str,
        joints: int,
        cycle_s: float,
        home: float,
        send: Say,
    ) -> None:
        self.robot = robot
        self.token: str | None = None
        self.misbehaviour: Misbehaviour | None = None
        self._mover = Mover(joints, cycle_s, home)
        self._send = send
        self._seq = 0
        self._asked_cycle = -_RETRY_CYCLES

    def take(self, message: Message) -> None:
        """A message of the HLI has come."""
        if isinstance(message, LeaseReply):
            self.token = message.lease if message.granted else None
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
                self._send(LeaseRequest(robot=self.robot, action=LeaseAction.ACQUIRE, client="mover"))
            return
        dq = self._mover.increment(state.q_cmd)
        match self.misbehaviour:
            case Misbehaviour.EVERY_FOURTH if state.cycle % 4:
                return
            case Misbehaviour.NAN_FLOOD:
                for _ in range(_FLOOD):
                    self._ask_nan(state, len(dq))
                return
            case Misbehaviour.LEAP:
                dq = np.sign(dq) * _LEAP_RAD
        self._seq += 1
        self._send(
            Increment(
                robot=self.robot, seq=self._seq, cycle=state.cycle, dq=tuple(dq.tolist()), lease=self.token
            )
        )

    def _ask_nan(self, state: RobotState, joints: int) -> None:
        self._seq += 1
        data = {
            "type": "increment",
            "robot": self.robot,
            "seq": self._seq,
            "cycle": state.cycle,
            "dq": [float("nan")] * joints,
            "lease": self.token,
        }
        try:
            self._send(from_map(Increment, data))
        except InvalidMessageError as error:
            self._send(error)
