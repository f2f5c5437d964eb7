"""The part of a report that all experiments share."""

from __future__ import annotations

from typing import Any

import numpy as np

from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.options import Options
from deltaq_experiments.report import Figures
from deltaq_experiments.scene import loop_latency_s
from deltaq_experiments.seen import SeenRun
from deltaq_experiments.trace import time_to_stay_below
from deltaq_experiments.virtual import RunRecord
from deltaq_protocol.arrays import Array


def summary(
    experiment: str,
    options: Options,
    scene: Scene,
    recording: RunRecord,
    angle_deg: Array,
    distance_error_m: Array,
    seen: SeenRun,
    elapsed_s: float,
) -> dict[str, Any]:
    """Fields of a `Report`.

    Args:
        experiment: its name.
        options: of the run.
        scene: who watches whom.
        recording: of the run.
        angle_deg: (k,) view angle error.
        distance_error_m: (k,) view distance less the desired one.
        seen: what was seen of the target.
        elapsed_s: time that it took.
    """
    trace = recording.trace
    settled = trace.time_s >= options.settle_s
    return {
        "experiment": experiment,
        "controller": options.controller,
        "robot": scene.robot_name,
        "leader": scene.leader_name,
        "seed": options.seed,
        "live": options.live,
        "cycles": len(trace.time_s),
        "cycle_s": scene.cycle_s,
        "latency_s": options.latency_s,
        "loop_latency_s": loop_latency_s(scene),
        "leader_speed_m_s": options.leader_speed_m_s,
        "stick_m_s2": options.stick_m_s2,
        "leader_reached_m_s": trace.reached_speed(scene.leader, options.settle_s),
        "angle_deg": Figures.of(np.abs(angle_deg), settled),
        "distance_m": Figures.of(np.abs(distance_error_m), settled),
        "roll_deg": Figures.of(np.abs(trace.rolls(scene.robot)), settled),
        "seen": seen.shares(options.settle_s),
        "time_to_1_deg_s": time_to_stay_below(trace.time_s, np.abs(angle_deg), 1.0),
        "clearance_m": trace.least_clearance(scene.cell),
        "limits": trace.limit_counts(scene.cell),
        "gate": recording.gate,
        "reasons": recording.reasons,
        "real_time_factor": float(trace.time_s[-1]) / elapsed_s,
    }
