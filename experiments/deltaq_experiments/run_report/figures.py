"""The figures of a run as `deltaq recording report --json` prints them."""

from datetime import UTC, datetime
from typing import Any

from deltaq_experiments.run_report.run import RecordedRun, RobotRun

LIVE = "live"
"""Source of a recording whose times are those of a clock."""


def begun_at(run: RecordedRun) -> str | None:
    """When the recording began, in UTC; None of a recording in virtual time."""
    if run.about.get("source") != LIVE:
        return None
    return datetime.fromtimestamp(run.begin_ns / 1e9, UTC).isoformat(timespec="seconds")


def figures(run: RecordedRun) -> dict[str, Any]:
    """A JSON object: SI units, times from the beginning of the recording."""
    return {
        "file": str(run.path),
        "sha256": run.sha256,
        "cell": run.about.get("cell"),
        "identity": run.about.get("identity"),
        "source": run.about.get("source"),
        "gate_fingerprints": run.gates,
        "begin": begun_at(run),
        "length_s": run.length_s,
        "cycle_s": run.cycle_s,
        "robots": {name: _robot(robot) for name, robot in run.robots.items()},
        "nearest": None
        if run.least is None
        else {
            "pair": run.least[0].pair,
            "distance_m": run.least[0].distance_m,
            "time_s": run.least[1],
        },
        "events": [
            {
                "time_s": event.time_s,
                "kind": event.kind.value,
                "robot": event.robot or None,
                "text": event.text,
                "count": event.count,
            }
            for event in run.events
        ],
        "notices": run.notices,
    }


def _robot(robot: RobotRun) -> dict[str, Any]:
    intervals = robot.intervals_s
    least = robot.least_clearance
    return {
        "cycles": int(robot.time_s.size),
        "missed_cycles": robot.missed_cycles,
        "restarts": robot.restarts,
        "interval_s": None
        if intervals is None
        else dict(zip(("median", "p99", "longest"), intervals, strict=True)),
        "admission_rate": robot.admission_rate,
        "verdicts": {outcome.value: count for outcome, count in robot.outcomes.items()},
        "reasons": [
            {
                "outcome": group.outcome.value,
                "code": group.code and group.code.value,
                "count": group.count,
                "first_s": group.first_s,
                "last_s": group.last_s,
                "limits": dict(group.limits.most_common()),
            }
            for group in sorted(robot.reasons.values(), key=lambda group: -group.count)
        ],
        "counters": dict(robot.counters),
        "clearance": None if least is None else {"least_m": least[0], "pair": least[1], "time_s": least[2]},
        "joints": _joints(robot),
    }


def _joints(robot: RobotRun) -> list[dict[str, Any]]:
    if not robot.time_s.size:
        return []
    summary, q = robot.summary, robot.q
    rows = zip(
        summary.joints, summary.units, summary.lower, summary.upper,
        q.min(axis=0).tolist(), q.max(axis=0).tolist(), robot.fastest.tolist(), strict=True,
    )  # fmt: skip
    return [
        {
            "name": name,
            "unit": unit,
            "lower": lower,
            "upper": upper,
            "least": least,
            "greatest": greatest,
            "margin": min(least - lower, upper - greatest),
            "fastest_share": fastest,
        }
        for name, unit, lower, upper, least, greatest, fastest in rows
    ]
