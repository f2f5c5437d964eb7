"""Phases of a robot: one table, run by the Robot Server and drawn by the documentation.

The Robot Server owns the phase of its robot, because it is the last program before the drives and outlives
the loss of every other one. An event that has no row for the present phase changes nothing.
"""

from dataclasses import dataclass
from enum import StrEnum

from deltaq_protocol.messages import Phase


class Event(StrEnum):
    """An event of a robot."""

    LINKED = "linked"
    """First messages of KRC and gate have come; the KRC's cycle and its mode of corrections are known."""
    ADMITTED = "admitted"
    """An admission of the gate was taken."""
    STARVED = "starved"
    """A cycle came without a fresh admission."""
    RESTED = "rested"
    """The brake has ended."""
    STOPPED = "stopped"
    """A stop was requested, or a link or the path was lost."""
    RESET = "reset"
    """Someone entitled to it reset the robot, at rest and with the cause gone."""


@dataclass(frozen=True)
class Transition:
    """In `phase`, `event` leads to `next_phase`."""

    phase: Phase
    event: Event
    next_phase: Phase


TRANSITIONS: tuple[Transition, ...] = (
    Transition(Phase.OFFLINE, Event.LINKED, Phase.READY),
    Transition(Phase.READY, Event.ADMITTED, Phase.ENGAGED),
    Transition(Phase.READY, Event.STOPPED, Phase.HELD),
    Transition(Phase.ENGAGED, Event.STARVED, Phase.BRAKING),
    Transition(Phase.ENGAGED, Event.STOPPED, Phase.HELD),
    Transition(Phase.BRAKING, Event.ADMITTED, Phase.ENGAGED),
    Transition(Phase.BRAKING, Event.RESTED, Phase.READY),
    Transition(Phase.BRAKING, Event.STOPPED, Phase.HELD),
    Transition(Phase.HELD, Event.RESET, Phase.READY),
)

_NEXT = {(row.phase, row.event): row.next_phase for row in TRANSITIONS}

MAY_MOVE = frozenset({Phase.READY, Phase.ENGAGED, Phase.BRAKING})
"""Phases in which an admission may be taken."""


def next_phase(phase: Phase, event: Event) -> Phase:
    """The phase that follows `event`; the present phase if the table has no row for it."""
    return _NEXT.get((phase, event), phase)
