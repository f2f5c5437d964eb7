"""Visibility of the camera's target in a recorded run."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltaq_controllers.camera.outlook import Visibility, VisibilityGauge
from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.figures import Marks
from deltaq_experiments.options import Options
from deltaq_experiments.report import Figures, LeastClearance, ReachedSpeed, SeenShares
from deltaq_experiments.scene import loop_latency_s
from deltaq_experiments.trace import Trace, time_to_stay_below
from deltaq_experiments.virtual import RunRecord
from deltaq_protocol.arrays import Array
from deltaq_testing.oracle import GateCounts, LimitCounts

EVERY_S = 0.06
"""Time between two checks of visibility; bodies hide a target for longer than this."""


@dataclass(frozen=True)
class SeenRun:
    """Checks of the target's visibility over a run.

    Attributes:
        time_s: (k,) times of the checks.
        looks: their results.
    """

    time_s: Array
    looks: Sequence[Visibility]

    def settled(self, settle_s: float) -> Sequence[Visibility]:
        """The checks from `settle_s` on, or all of a run that is shorter."""
        counted = [look for time_s, look in zip(self.time_s, self.looks, strict=True) if time_s >= settle_s]
        return counted or self.looks

    def hidden(self) -> Marks:
        """Where an eye does not see the target, for a figure."""
        return Marks("target hidden", self.time_s, np.array([not look.is_seen for look in self.looks]))


def shares_of(looks: Sequence[Visibility]) -> SeenShares:
    """Shares of some looks, at least one."""
    bodies: Counter[str] = Counter()
    owners: Counter[str] = Counter()
    for look in looks:
        blocking = {body for line in look.blocked_by for body in line}
        bodies.update(blocking)
        owners.update({body.split("/")[0] for body in blocking})
    count = len(looks)
    return SeenShares(
        by_all_eyes=sum(look.is_seen for look in looks) / count,
        by_one_eye=sum(look.eyes_seeing > 0 for look in looks) / count,
        in_picture=sum(all(look.in_picture) for look in looks) / count,
        blocked_by={owner: number / count for owner, number in owners.most_common()},
        bodies={body: number / count for body, number in bodies.most_common()},
    )


def seen(scene: Scene, trace: Trace, target: Callable[[Array], Array]) -> SeenRun:
    """The target's visibility in a run.

    Args:
        scene: the roles of the robots.
        trace: of its robots.
        target: returns the watched point (3,) in the world from the leader's configuration [m].
    """
    gauge = VisibilityGauge(scene.cell, scene.robot_name)
    every = max(1, round(EVERY_S / scene.cycle_s))
    indices = range(0, len(trace.time_s), every)
    q_leader = trace.q[scene.leader_name]
    looks = [gauge.look({name: q[k] for name, q in trace.q.items()}, target(q_leader[k])) for k in indices]
    return SeenRun(trace.time_s[::every], looks)


@dataclass(frozen=True)
class CameraRun:
    """A run as its camera saw it.

    Attributes:
        recording: of the run.
        angle_deg: (k,) view angle error.
        distance_error_m: (k,) view distance less the desired one.
        seen: the target's visibility.
    """

    recording: RunRecord
    angle_deg: Array
    distance_error_m: Array
    seen: SeenRun


def summary(
    experiment: str, options: Options, scene: Scene, elapsed_s: float, *runs: CameraRun
) -> dict[str, Any]:
    """Fields of a `Report` on all runs together.

    Args:
        experiment: its name.
        options: of the runs.
        scene: the roles of the robots.
        elapsed_s: wall time of the runs.
        runs: one or more.
    """
    traces = [run.recording.trace for run in runs]
    settled = np.concatenate([trace.time_s >= options.settle_s for trace in traces])
    angles = [np.abs(run.angle_deg) for run in runs]
    distances = [np.abs(run.distance_error_m) for run in runs]
    rolls = [np.abs(trace.rolls(scene.robot)) for trace in traces]
    speeds = [trace.reached_speed(scene.leader, options.settle_s) for trace in traces]
    times = [time_to_stay_below(*pair, 1.0) for pair in zip((t.time_s for t in traces), angles, strict=True)]
    clearances = [trace.least_clearance(scene.cell) for trace in traces]
    reasons: Counter[str] = Counter()
    for run in runs:
        reasons.update(run.recording.reasons)
    return {
        "experiment": experiment,
        "controller": options.controller,
        "robot": scene.robot_name,
        "leader": scene.leader_name,
        "seed": options.seed,
        "live": options.live,
        "cycles": len(settled),
        "cycle_s": scene.cycle_s,
        "latency_s": options.latency_s,
        "loop_latency_s": loop_latency_s(scene),
        "leader_speed_m_s": options.leader_speed_m_s,
        "stick_m_s2": options.stick_m_s2,
        "leader_reached_m_s": ReachedSpeed(
            mean=float(np.mean([speed.mean for speed in speeds])), peak=max(speed.peak for speed in speeds)
        ),
        "angle_deg": Figures.of(np.concatenate(angles), settled),
        "distance_m": Figures.of(np.concatenate(distances), settled),
        "roll_deg": Figures.of(np.concatenate(rolls), settled),
        "seen": shares_of([look for run in runs for look in run.seen.settled(options.settle_s)]),
        "time_to_1_deg_s": None if None in times else max(time_s for time_s in times if time_s is not None),
        "clearance_m": LeastClearance.of(clearances),
        "limits": LimitCounts.sum(trace.limit_counts(scene.cell) for trace in traces),
        "gate": GateCounts.sum(run.recording.gate for run in runs),
        "reasons": dict(reasons),
        "real_time_factor": sum(float(trace.time_s[-1]) for trace in traces) / elapsed_s,
    }
