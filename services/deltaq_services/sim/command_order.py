"""The order of commands from the HLI: each is taken once, in order, and only while it is fresh."""

from __future__ import annotations

from collections.abc import Iterable

from deltaq_protocol.guarded import Command, CommandReply
from deltaq_protocol.messages import MOST_COUNTED_ON
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.gated_robot import GatedRobot


class CommandOrder:
    """The commands so far, so that none that was duplicated, overtaken or delayed is taken.

    Attributes:
        newest_id: the greatest id of a command so far.
    """

    def __init__(self) -> None:
        self.newest_id = 0

    def refusal(self, command: Command, epoch: int, robots: Iterable[GatedRobot]) -> CommandReply | None:
        """Why a command must not be taken, as the reply to it; None if it may.

        Args:
            command: any but a stop, which is obeyed whenever it comes.
            epoch: of this gate.
            robots: names of the robots that the command concerns.
        """
        if command.epoch != epoch:
            return self._refused(
                command, epoch, ReasonCode.STALE_EPOCH, f"gate epoch {command.epoch}, this is {epoch}"
            )
        if command.id >= MOST_COUNTED_ON:
            said = f"id {command.id}, it has to be less than {MOST_COUNTED_ON}"
            return self._refused(command, epoch, ReasonCode.MALFORMED, said)
        if command.id <= self.newest_id:
            said = f"id {command.id}, the newest so far is {self.newest_id}"
            return self._refused(command, epoch, ReasonCode.REPLAYED_SEQUENCE, said)
        for robot in robots:
            state, seen = robot.tracker.state, command.cycles.get(robot.name)
            if state is not None and (seen is None or state.cycle - seen > robot.max_age_cycles):
                said = f"goes by cycle {seen} of {robot.name}, which is at {state.cycle}"
                return self._refused(command, epoch, ReasonCode.STALE_CYCLE, said)
        return None

    def passed(self, command: Command) -> None:
        """A command was taken, or is out of date: nothing that was sent before it counts any more."""
        if command.id < MOST_COUNTED_ON:
            self.newest_id = max(self.newest_id, command.id)

    def _refused(self, command: Command, epoch: int, code: ReasonCode, message: str) -> CommandReply:
        return CommandReply(
            id=command.id,
            accepted=False,
            code=code,
            message=message,
            epoch=epoch,
            newest_id=self.newest_id,
        )
