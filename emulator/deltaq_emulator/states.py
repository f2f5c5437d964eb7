"""States of the emulated controller and what leads from one to another."""

from __future__ import annotations

from enum import StrEnum

from deltaq_protocol.errors import DeltaqError


class KrcState(StrEnum):
    """State of the controller."""

    DRIVES_OFF = "drives off"
    READY = "ready"
    RSI_RUNNING = "RSI running"
    STOPPED = "stopped"
    """A fault stopped the program; its message waits for the operator's acknowledgement."""


class KrcEvent(StrEnum):
    """What can happen to it."""

    DRIVES_ON = "drives on"
    DRIVES_OFF = "drives off"
    START = "start"
    STOP = "stop"
    FAULT = "fault"
    ACKNOWLEDGE = "acknowledge"
    CHANGE_MODE = "change mode"


TRANSITIONS: dict[tuple[KrcState, KrcEvent], KrcState] = {
    (KrcState.DRIVES_OFF, KrcEvent.DRIVES_ON): KrcState.READY,
    (KrcState.DRIVES_OFF, KrcEvent.CHANGE_MODE): KrcState.DRIVES_OFF,
    (KrcState.READY, KrcEvent.DRIVES_OFF): KrcState.DRIVES_OFF,
    (KrcState.READY, KrcEvent.CHANGE_MODE): KrcState.READY,
    (KrcState.READY, KrcEvent.START): KrcState.RSI_RUNNING,
    (KrcState.READY, KrcEvent.STOP): KrcState.READY,
    (KrcState.RSI_RUNNING, KrcEvent.STOP): KrcState.READY,
    (KrcState.RSI_RUNNING, KrcEvent.FAULT): KrcState.STOPPED,
    (KrcState.RSI_RUNNING, KrcEvent.DRIVES_OFF): KrcState.DRIVES_OFF,
    (KrcState.RSI_RUNNING, KrcEvent.CHANGE_MODE): KrcState.READY,
    (KrcState.STOPPED, KrcEvent.ACKNOWLEDGE): KrcState.READY,
    (KrcState.STOPPED, KrcEvent.CHANGE_MODE): KrcState.STOPPED,
}


class NotNowError(DeltaqError):
    """The controller does not do that in the state it is in."""


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
