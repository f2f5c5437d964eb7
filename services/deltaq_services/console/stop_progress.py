"""How far a stop has come: asked for, latched by the gate, and every robot at rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.console.messages import StopPhase


@dataclass(frozen=True)
class RobotMotion:
    """What a stop has to know of a robot.

    Attributes:
        phase: its phase; None while its states do not come: nothing is known then.
        reason: why it is held.
        is_still: its setpoint and its axes stand still.
    """

    phase: Phase | None
    reason: ReasonCode | None = None
    is_still: bool = False


class StopProgress:
    """The newest stop of any sender.

    Attributes:
        phase: how far it is.
        by: name of the client that asked; None if that was somebody outside this console.
    """

    def __init__(self) -> None:
        self.phase = StopPhase.NONE
        self.by: str | None = None
        self._seen_held = False

    def ask(self, name: str) -> None:
        """A client asks for a stop."""
        self.by = name
        self.phase = StopPhase.ASKED
        self._seen_held = False

    def latched(self) -> None:
        """The HLI has replied that every robot is held."""
        if self.phase is StopPhase.ASKED:
            self.phase = StopPhase.STOPPING

    def see(self, robots: Mapping[str, RobotMotion]) -> None:
        """The robots' newest states.

        Robots that are held at rest confirm a stop that was asked for, whatever holds them: their KRC fell silent, too.
        """
        held = all(motion.phase in (Phase.HELD, Phase.OFFLINE) for motion in robots.values())
        stopped = any(_is_stopped(motion) for motion in robots.values())
        at_rest = all(motion.is_still or motion.phase is Phase.OFFLINE for motion in robots.values())
        if self.phase in (StopPhase.NONE, StopPhase.ASKED):
            if held and (stopped or (at_rest and self.phase is StopPhase.ASKED)):
                self.phase, self._seen_held = StopPhase.STOPPING, True
        elif held:
            self._seen_held = True
            self.phase = StopPhase.AT_REST if at_rest else StopPhase.STOPPING
        elif self._seen_held and not any(motion.phase is None for motion in robots.values()):
            # somebody has reset one of them. The HLI's reply may come before the states that it speaks of, and nothing
            # new is known of robots that are not heard
            self.phase, self.by = StopPhase.NONE, None


def _is_stopped(motion: RobotMotion) -> bool:
    return motion.phase is Phase.HELD and motion.reason is ReasonCode.OPERATOR_STOP
