"""A controller that speaks JSON lines, in virtual time: whenever it has been told a state, it has its say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from deltaq_protocol.codec import InvalidMessageError, from_map, line_to_map, to_line
from deltaq_protocol.messages import Increment, LeaseReply, LeaseRequest, Message, RobotState
from deltaq_services.hli.line_requests import request_type
from deltaq_testing.controller_process import ControllerProcess
from deltaq_testing.faults.actions import Misbehaviour
from deltaq_testing.faults.controller import increment_of, misbehaved
from deltaq_testing.virtual_cell.clients import Say


class LineController:
    """One connection of a program to the HLI.

    Args:
        robot: that it drives.
        program: the program; it is started.
        note: is shown all that the HLI says.
        gone: is told when the program has closed its end.
        say: sends to the HLI.

    Attributes:
        robot: that it drives.
        token: of its lease; None without one.
        misbehaviour: None while its increments go out as it says them.
    """

    def __init__(
        self,
        robot: str,
        program: ControllerProcess,
        note: Callable[[Message], None],
        gone: Callable[[], None],
        say: Say,
    ) -> None:
        self.robot = robot
        self.token: str | None = None
        self.misbehaviour: Misbehaviour | None = None
        self._program, self._note, self._gone, self._say = program, note, gone, say
        self._name, self._asked = "", False
        program.start()

    def take(self, message: Message) -> None:
        """A message of the HLI has come; a state waits for its answer.

        Raises:
            ControllerProcessError: the program does not answer.
        """
        self._note(message)
        if isinstance(message, LeaseReply):
            self.token = message.lease if message.granted else self.token
            message = message.model_copy(update={"lease": None})
        if not isinstance(message, RobotState):
            self._program.say(to_line(message))
            return
        there = True
        while there and not self._asked:
            there = self._listen("it was started")  # it asks for its lease before anything moves
        self._program.say(to_line(message))
        if not (there and self._listen(f"the state of cycle {message.cycle}")):
            self._gone()

    def _listen(self, awaited: str) -> bool:
        """Let it say one line; whether it did."""
        line = self._program.hear(awaited)
        if line is None:
            return False
        try:
            self._pass_on(line_to_map(line))
        except InvalidMessageError as error:
            self._say(error)
        return True

    def _pass_on(self, data: dict[str, Any]) -> None:
        message_type = request_type(data)
        if message_type is Increment:
            dq, cycle = data.get("dq"), data.get("cycle")
            errs = self.misbehaviour is not None and isinstance(dq, list) and isinstance(cycle, int)
            for asked in (
                misbehaved(self.misbehaviour, cycle, dq) if errs and isinstance(cycle, int) else [dq]
            ):
                self._say(increment_of({**data, "dq": asked}, self.token))
            return
        request = from_map(message_type, data)
        if isinstance(request, LeaseRequest):
            self._asked = True
            request = request.model_copy(update={"lease": self.token, "client": self._name})
        self._name = data.get("client", self._name)
        self._say(request)
