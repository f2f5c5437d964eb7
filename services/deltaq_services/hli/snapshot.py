"""What the HLI remembers from one message to the next: values, from which another goes on as it would have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from deltaq_protocol.guarded import Health
from deltaq_services.hli.commands import CommandsMemory
from deltaq_services.hli.leases import LeasesMemory
from deltaq_services.hli.robot_link import LinkMemory


@dataclass(frozen=True, slots=True)
class HliMemory:
    """Snapshot of the HLI's core, counters excepted. Senders are in it as they are: nobody can copy a connection.

    Attributes:
        links: by robot.
        mismatches: services that have read another cell, and what to say of them.
        gate: its newest heartbeat, and when that was heard.
        heard_s: when each stream was heard.
        proximity_s: when the nearest pair is due.
        command_rate: what clients may still ask of the gate.
    """

    leases: LeasesMemory
    commands: CommandsMemory
    links: Mapping[str, LinkMemory]
    mismatches: Mapping[str, str]
    gate: tuple[Health | None, float]
    heard_s: tuple[tuple[float, ...], ...]
    proximity_s: float
    command_rate: tuple[float, float | None]
