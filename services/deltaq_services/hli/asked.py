"""An increment that passed all checks of the HLI."""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_protocol.messages import Increment
from deltaq_services.outputs import Sender


@dataclass(frozen=True, slots=True)
class Asked:
    """An increment that passed all checks, who sent it, under which lease, and in which cycle it came."""

    increment: Increment
    lease_epoch: int
    sender: Sender | None
    came: int
