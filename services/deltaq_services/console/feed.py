"""The newest states and verdicts of each robot, and the frame that shows them. Pure: the caller passes the times.

A frame is the binary message that a browser gets 25 times a second: where the robots are, little endian.

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
    f32[3] focus     target of its camera, in the world [m]; NaN without one
    f32[n] q         measured [rad or m]
    f32[n] q_rest    where it would come to rest if it braked now [rad or m]

Indices of phases and outcomes are places in `PHASES` and `OUTCOMES`.
"""

import math
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deltaq_cell.description import RobotDescription
from deltaq_protocol.arrays import Array
from deltaq_protocol.brake import brake_cycles, brake_travel
from deltaq_protocol.messages import NearestPair, Outcome, Phase, RobotState, Vector3, Verdict
from deltaq_protocol.reasons import ReasonCode

VERSION = 2
PHASES = tuple(Phase)
OUTCOMES = tuple(Outcome)
NO_OUTCOME = 255
NO_BODY = 65535
STALE, BRAKING = 1, 2

WINDOW_S = 1.0
"""Time over which rates are taken."""
STALE_S = 0.25
"""A state that is older is shown as stale: twenty cycles of 12 ms."""
VERDICT_S = 0.5
"""An older verdict is no longer shown: the robot has no driver."""

CREEP = 0.001
"""Fraction of the joints' speed limits below which axes count as still: sensors are not without noise."""

_HEAD = struct.Struct("<BBHdHHf6f")
_ROBOT = struct.Struct("<BBBBffHHff3f")
_NAN3 = (math.nan, math.nan, math.nan)


def pack_frame(
    server_s: float, nearest: NearestPair | None, bodies: Mapping[str, int], robots: Sequence[bytes]
) -> bytes:
    """The bytes of a frame.

    Args:
        server_s: clock of the server [s].
        nearest: the nearest bodies of the cell; None if they are not known.
        bodies: place of each body in the scene's list, by name.
        robots: the part of each robot, from `RobotFeed.packed`.
    """
    near = [NO_BODY, NO_BODY, math.nan, *_NAN3, *_NAN3]
    if nearest is not None:
        places = (bodies.get(name, NO_BODY) for name in nearest.pair)
        near = [*places, nearest.distance_m, *nearest.points_m[0], *nearest.points_m[1]]
    return b"".join((_HEAD.pack(VERSION, len(robots), 0, server_s, *near), *robots))


@dataclass(frozen=True)
class RobotMotion:
    """The motion of a robot, to judge the progress of a stop.

    Attributes:
        phase: its phase; None while no states come.
        reason: why it is held.
        is_still: whether its setpoint and its axes are at rest.
    """

    phase: Phase | None
    reason: ReasonCode | None = None
    is_still: bool = False


class RobotFeed:
    """The newest data of one robot.

    Args:
        robot: its description.
        cycle_s: its cycle [s].
        bodies: place of each body in the scene's list, by name.

    Attributes:
        state: the newest state, None before the first.
        verdict: the newest verdict, None before the first.
    """

    def __init__(self, robot: RobotDescription, cycle_s: float, bodies: Mapping[str, int]) -> None:
        self.state: RobotState | None = None
        self.verdict: Verdict | None = None
        self._home = robot.home
        self._max_dv = robot.max_acceleration * cycle_s**2
        self._creep = CREEP * robot.max_velocity * cycle_s
        self._bodies = bodies
        self._dq: Array = np.zeros(len(self._home))
        self._measured: Array = np.full(len(self._home), math.inf)
        self._state_s = self._verdict_s = -math.inf
        self._outcomes: deque[tuple[float, Outcome]] = deque()
        self._gaps: deque[tuple[float, float]] = deque()

    def arrived(self, gap_s: float, now_s: float) -> None:
        """Note the longest time between two states since the last call [s]."""
        self._gaps.append((now_s, gap_s))

    def take_state(self, state: RobotState, arrived_s: float) -> bool:
        """Take a newer state; returns whether it is one of this robot."""
        if len(state.q) != len(self._home) or len(state.q_cmd) != len(self._home):
            return False
        before = self.state
        if before is not None and state.cycle > before.cycle:
            cycles = state.cycle - before.cycle
            self._dq = np.subtract(state.q_cmd, before.q_cmd) / cycles
            self._measured = np.subtract(state.q, before.q) / cycles
        self.state, self._state_s = state, arrived_s
        return True

    def take_verdict(self, verdict: Verdict, arrived_s: float) -> None:
        """Take a verdict on this robot."""
        self.verdict, self._verdict_s = verdict, arrived_s
        self._outcomes.append((arrived_s, verdict.outcome))

    def is_stale(self, now_s: float) -> bool:
        """Whether the newest state is too old to be acted upon."""
        return now_s - self._state_s > STALE_S

    def packed(self, now_s: float, focus: Vector3 | None) -> bytes:
        """The robot's part of a frame at `now_s`.

        Args:
            now_s: time [s].
            focus: target of its camera, in the world [m].
        """
        for waiting in (self._outcomes, self._gaps):
            while waiting and waiting[0][0] < now_s - WINDOW_S:
                waiting.popleft()
        verdict = self.verdict if now_s - self._verdict_s <= VERDICT_S else None
        state, age_s = self.state, now_s - self._state_s
        phase = Phase.OFFLINE if state is None else state.phase
        is_braking = phase is Phase.BRAKING or (phase is Phase.HELD and bool(self._dq.any()))
        admitted = [outcome is Outcome.ADMITTED for _, outcome in self._outcomes]
        gaps = [gap for _, gap in self._gaps] + ([age_s] if math.isfinite(age_s) else [])
        q = self._home if state is None else np.array(state.q)
        return (
            _ROBOT.pack(
                len(q),
                PHASES.index(phase),
                NO_OUTCOME if verdict is None else OUTCOMES.index(verdict.outcome),
                STALE * self.is_stale(now_s) + BRAKING * is_braking,
                age_s,
                math.nan if verdict is None or verdict.clearance_m is None else verdict.clearance_m,
                *self._places(None if verdict is None else verdict.pair),
                sum(admitted) / len(admitted) if admitted else math.nan,
                max(gaps, default=math.nan),
                *(focus or _NAN3),
            )
            + np.concatenate([q, self._rest(state)]).astype("<f4").tobytes()
        )

    @property
    def is_still(self) -> bool:
        """Whether setpoint and axes are at rest, by the two newest states."""
        return bool((self._dq == 0.0).all() and (np.abs(self._measured) < self._creep).all())

    def _rest(self, state: RobotState | None) -> Array:
        """Where the brake that follows the last increment would end."""
        if state is None:
            return self._home
        cycles = brake_cycles(self._dq, self._max_dv)
        rest: Array = np.array(state.q_cmd) + brake_travel(self._dq, cycles, 0)
        return rest

    def _places(self, pair: tuple[str, str] | None) -> tuple[int, int]:
        a, b = pair or ("", "")
        return self._bodies.get(a, NO_BODY), self._bodies.get(b, NO_BODY)
