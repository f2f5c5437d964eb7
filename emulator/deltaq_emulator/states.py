"""States of the emulated controller and its program, and the events between them.

The program is the one that every RSI application begins with: RSI_ON, RSI_MOVECORR, RSI_OFF. `docs/reference/krc.md`
is drawn from this table.
"""

from enum import StrEnum

from deltaq_protocol.errors import DeltaqError


class KrcState(StrEnum):
    """State of the controller."""

    DRIVES_OFF = "drives off"
    """No program runs."""
    READY = "ready"
    """The drives are on, and no program runs."""
    RSI_ON = "RSI on"
    """RSI_ON has been executed and RSI_MOVECORR has not: telegrams are exchanged, and no correction moves the robot."""
    RSI_RUNNING = "RSI running"
    """RSI_MOVECORR is being executed: corrections move the robot."""
    MOTION_ENDED = "motion ended"
    """The PC ended RSI_MOVECORR: the drives stop along their own ramps, and telegrams continue until RSI_OFF."""
    STOPPED = "stopped"
    """A fault stopped the program; its message waits for the operator's acknowledgement."""


class KrcEvent(StrEnum):
    """An event of the controller."""

    DRIVES_ON = "drives on"
    """The operator switches the drives on."""
    DRIVES_OFF = "drives off"
    """The operator switches the drives off."""
    START = "start"
    """The operator starts the program, and it has reached RSI_ON."""
    CONFIRM = "confirm"
    """RSI_MOVECORR begins: in T1 when the operator has confirmed its warning, else at once."""
    END_MOTION = "end motion"
    """The signal that the cell names in `driver.stop` rises."""
    END = "end"
    """The robot rests after the motion was ended, and the program has reached RSI_OFF and its end."""
    STOP = "stop"
    """The operator stops the program."""
    FAULT = "fault"
    """A limit was exceeded, or too many replies were late."""
    ACKNOWLEDGE = "acknowledge"
    """The operator acknowledges the message of a fault."""
    CHANGE_MODE = "change mode"
    """The operator turns the key."""


TELEGRAMS_GO_OUT = frozenset({KrcState.RSI_ON, KrcState.RSI_RUNNING, KrcState.MOTION_ENDED})
"""States in which the controller sends telegrams and waits for replies."""


def _program_runs(state: KrcState) -> dict[tuple[KrcState, KrcEvent], KrcState]:
    """Events that end the program in any state."""
    return {
        (state, KrcEvent.STOP): KrcState.READY,
        (state, KrcEvent.FAULT): KrcState.STOPPED,
        (state, KrcEvent.DRIVES_OFF): KrcState.DRIVES_OFF,
        (state, KrcEvent.CHANGE_MODE): KrcState.READY,
    }


TRANSITIONS: dict[tuple[KrcState, KrcEvent], KrcState] = {
    (KrcState.DRIVES_OFF, KrcEvent.DRIVES_ON): KrcState.READY,
    (KrcState.DRIVES_OFF, KrcEvent.CHANGE_MODE): KrcState.DRIVES_OFF,
    (KrcState.READY, KrcEvent.DRIVES_OFF): KrcState.DRIVES_OFF,
    (KrcState.READY, KrcEvent.CHANGE_MODE): KrcState.READY,
    (KrcState.READY, KrcEvent.START): KrcState.RSI_ON,
    (KrcState.READY, KrcEvent.STOP): KrcState.READY,
    (KrcState.RSI_ON, KrcEvent.CONFIRM): KrcState.RSI_RUNNING,
    **_program_runs(KrcState.RSI_ON),
    (KrcState.RSI_RUNNING, KrcEvent.END_MOTION): KrcState.MOTION_ENDED,
    **_program_runs(KrcState.RSI_RUNNING),
    (KrcState.MOTION_ENDED, KrcEvent.END): KrcState.READY,
    **_program_runs(KrcState.MOTION_ENDED),
    (KrcState.STOPPED, KrcEvent.ACKNOWLEDGE): KrcState.READY,
    (KrcState.STOPPED, KrcEvent.CHANGE_MODE): KrcState.STOPPED,
}


class NotNowError(DeltaqError):
    """The controller cannot do that in its present state."""


def after(state: KrcState, event: KrcEvent) -> KrcState:
    """The state that `event` leads to.

    Raises:
        NotNowError: if the event is not possible in that state; the message says what is.
    """
    try:
        return TRANSITIONS[state, event]
    except KeyError:
        possible = ", ".join(other for at, other in TRANSITIONS if at is state)
        raise NotNowError(f"'{event}' is not possible while {state}; possible are: {possible}") from None
