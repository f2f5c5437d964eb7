"""The running cell."""

from __future__ import annotations

from typing import Literal

from deltaq_protocol.messages.base import PROTOCOL_VERSION, Count, Message, Real, Vector3
from deltaq_protocol.messages.motion import Phase
from deltaq_protocol.reasons import ReasonCode


class NearestPair(Message):
    """Two bodies, their distance and the witness points in world coordinates [m]."""

    pair: tuple[str, str]
    distance_m: Real
    points_m: tuple[Vector3, Vector3]


class Proximity(Message):
    """The nearest pairs of the cell, nearest first; published at a reduced rate."""

    type: Literal["proximity"] = "proximity"
    time_s: Real
    pairs: tuple[NearestPair, ...]


class LeaseStatus(Message):
    """The holder of a robot's lease."""

    holder: str | None = None
    expires_s: Real | None = None
    epoch: Count = 0


class RobotStatus(Message):
    """One robot as `deltaq status` shows it; `lag_s` is the measured lag of each axis, null where it is not known."""

    phase: Phase
    reason: ReasonCode | None
    cycle: Count
    state_age_s: Real | None
    q: tuple[Real, ...]
    lease: LeaseStatus
    counters: dict[str, Count]
    lag_s: tuple[Real | None, ...] = ()


class Status(Message):
    """The running cell as `deltaq status` shows it.

    `contacts` has the contacts that are allowed now; `lagging` names the streams that are silent, or slower than the
    table of topics requires. `identity` is the cell's name and hash, and `mismatches` names the services that have read
    another cell.
    """

    type: Literal["status"] = "status"
    cell: str
    protocol: int = PROTOCOL_VERSION
    robots: dict[str, RobotStatus]
    gate: dict[str, Count]
    gate_age_s: Real | None
    gate_fingerprint: str = ""
    contacts: tuple[str, ...] = ()
    hli: dict[str, Count]
    nearest: NearestPair | None = None
    lagging: tuple[str, ...] = ()
    identity: str = ""
    mismatches: tuple[str, ...] = ()
