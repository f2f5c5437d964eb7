"""What a Robot Server remembers from one telegram to the next: a value, from which another goes on as it would have."""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_protocol.guarded import Admission, ServerState, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.robot_server.lag_watch import LagMemory
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.mode_probe import ProbeMemory
from deltaq_services.robot_server.pulses_cut_short import PulsesMemory

JointValues = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class ServerMemory:
    """Snapshot of a Robot Server's core, counters excepted; places [rad or m].

    Attributes:
        motion: what was sent last; its arrays are never written to.
        cycles_at_rest, q_settled: of `Settling`.
        told: the last measurement, and when it came.
        state: what is published; None before the first cycle.
        mode: of the session; None for that of a robot that is no KUKA.
        lag: of the moving axes; None before the probe has told it.
        pulses: of its probe, and of those that other sessions cut short.
        admissions: admissions that are due in a later cycle.
        supervision: the newest that no cycle has had yet.
    """

    process: int
    cycle: int
    phase: Phase
    reason: ReasonCode | None
    motion: SetpointMotion
    q_reset: JointValues | None
    epoch: int
    resets: int
    cycles_without_gate: int
    cycles_missed: int
    cycles_at_rest: int
    q_settled: JointValues | None
    motion_stop: bool
    outputs: tuple[tuple[str, bool], ...]
    told: tuple[Measurement, float] | None
    state: ServerState | None
    mode: ProbeMemory | None
    lag: LagMemory | None
    pulses: PulsesMemory
    admissions: tuple[Admission, ...]
    supervision: Supervision | None
