"""The binary message that a browser gets 25 times a second: where the robots are, little endian.

    u8 version = 2   u8 robots   u16 reserved
    f64 server_s     clock of the server [s]
    u16 a   u16 b    the nearest bodies of the cell, by their place in the scene's `bodies`; 65535: none
    f32 distance     of those [m]; NaN without them
    f32[3]  f32[3]   their nearest points, in the world [m]
    then for each robot, in the order of the scene:
    u8 joints   u8 phase   u8 outcome (255: none)   u8 flags (bit 0 stale, bit 1 braking)
    f32 age          of the state [s]
    f32 clearance    of the last verdict's tightest pair [m]; NaN without one
    u16 a   u16 b    that pair
    f32 admission    share of the increments of the last second that were admitted whole; NaN without any
    f32 longest      longest time between two states in the last second [s]
    f32[3] focus     what its camera looks at, in the world [m]; NaN without one
    f32[n] q         measured [rad or m]
    f32[n] q_rest    where it would come to rest if it braked now [rad or m]

Indices of phases and outcomes are places in `PHASES` and `OUTCOMES`.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Outcome, Phase, Vector3

VERSION = 2
PHASES = tuple(Phase)
OUTCOMES = tuple(Outcome)
NO_OUTCOME = 255
NO_BODY = 65535
STALE, BRAKING = 1, 2

_HEAD = struct.Struct("<BBHdHHf6f")
_ROBOT = struct.Struct("<BBBBffHHff3f")
_NAN3 = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class WitnessedPair:
    """The nearest bodies of the cell: their places in the scene's `bodies`, distance and points in the world [m]."""

    a: int = NO_BODY
    b: int = NO_BODY
    distance_m: float = math.nan
    points_m: tuple[Vector3, Vector3] = (_NAN3, _NAN3)


@dataclass(frozen=True)
class RobotFrame:
    """One robot of a frame; see the module for units.

    Attributes:
        phase: its phase.
        outcome: of the last verdict; None without one.
        is_stale: the state is too old to be acted upon.
        is_braking: it follows a brake.
        age_s: of the state.
        clearance_m: of the tightest pair of the last verdict.
        pair: indices of this pair in the scene's `bodies`.
        admission: share of increments admitted whole in the last second.
        longest_cycle_s: longest time between two states in the last second.
        focus: what its camera looks at; None without one.
        q: (n,) measured.
        q_rest: (n,) configuration in which it would come to rest.
    """

    phase: Phase
    outcome: Outcome | None
    is_stale: bool
    is_braking: bool
    age_s: float
    clearance_m: float
    pair: tuple[int, int]
    admission: float
    longest_cycle_s: float
    focus: Vector3 | None
    q: Array
    q_rest: Array


def pack_frame(server_s: float, nearest: WitnessedPair, robots: Sequence[RobotFrame]) -> bytes:
    """The bytes of a frame."""
    first, second = nearest.points_m
    parts = [
        _HEAD.pack(
            VERSION,
            len(robots),
            0,
            server_s,
            nearest.a,
            nearest.b,
            nearest.distance_m,
            *first,
            *second,
        )
    ]
    for robot in robots:
        parts.append(
            _ROBOT.pack(
                len(robot.q),
                PHASES.index(robot.phase),
                NO_OUTCOME if robot.outcome is None else OUTCOMES.index(robot.outcome),
                STALE * robot.is_stale + BRAKING * robot.is_braking,
                robot.age_s,
                robot.clearance_m,
                *robot.pair,
                robot.admission,
                robot.longest_cycle_s,
                *(robot.focus or _NAN3),
            )
        )
        parts.append(np.concatenate([robot.q, robot.q_rest]).astype("<f4").tobytes())
    return b"".join(parts)
