"""Writes `deploy/grafana/deltaq.json`, a dashboard for Grafana to import: `python -m deltaq_deploy.grafana`.

It shows what `deltaq metrics` tells. A test holds what it asks for against what a running exporter tells.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

FILE = Path(__file__).parents[1] / "grafana" / "deltaq.json"
_WIDTH, _HEIGHT, _COLUMNS = 12, 8, 2
_SOURCE = {"type": "prometheus", "uid": "${source}"}
_RATE = "[$__rate_interval]"

_PANELS = (
    (
        "Admission rate",
        "percentunit",
        "Cycles with a fresh admission, of all",
        (
            (
                f"sum by (robot) (rate(deltaq_admissions_total{_RATE}))"
                f" / sum by (robot) (rate(deltaq_cycles_total{_RATE}))",
                "{{robot}}",
            ),
        ),
    ),
    (
        "Cycles of the brake a second, by cause",
        "short",
        "No admission had come in time, one was not taken, or the robot is held",
        ((f"rate(deltaq_braked_cycles_total{_RATE})", "{{robot}} {{cause}}"),),
    ),
    (
        "Admissions not taken, by reason",
        "short",
        "Admissions that came and were not taken, a second; those that never came are cycles of the brake alone",
        ((f"rate(deltaq_admissions_not_taken_total{_RATE})", "{{robot}} {{reason}}"),),
    ),
    (
        "Verdicts a second",
        "short",
        "By outcome",
        ((f"rate(deltaq_verdicts_total{_RATE})", "{{outcome}}"),),
    ),
    (
        "Refusals a second, by reason",
        "short",
        "Increments that never reached the gate",
        ((f"rate(deltaq_refusals_total{_RATE})", "{{reason}}"),),
    ),
    (
        "What bound the gate, verdicts a second",
        "short",
        "By the first reason",
        ((f"rate(deltaq_gate_reasons_total{_RATE})", "{{reason}}"),),
    ),
    ("Clearance", "lengthm", "Distance of the nearest pair", (("deltaq_clearance_metres", "nearest pair"),)),
    (
        "Phases",
        "short",
        "1 for the phase that a robot is in",
        (("deltaq_phase == 1", "{{robot}} {{phase}}"),),
    ),
    (
        "From a state to its verdict",
        "s",
        "Where the exporter runs: half of all verdicts, and 99 of a hundred",
        tuple(
            (
                f"histogram_quantile({share}, sum by (robot, le)"
                f" (rate(deltaq_verdict_delay_seconds_bucket{_RATE})))",
                f"{{{{robot}}}} {name}",
            )
            for share, name in ((0.5, "p50"), (0.99, "p99"))
        ),
    ),
    (
        "Between two states",
        "s",
        "Where the exporter runs: 99 of a hundred",
        (
            (
                "histogram_quantile(0.99, sum by (robot, le)"
                f" (rate(deltaq_state_interval_seconds_bucket{_RATE})))",
                "{{robot}} p99",
            ),
        ),
    ),
    (
        "Held, times in the last hour",
        "short",
        "By reason",
        (("increase(deltaq_held_total[1h])", "{{robot}} {{reason}}"),),
    ),
    (
        "Clients",
        "short",
        "Robots that are leased, connections over TCP, and zenoh sessions",
        (
            ("deltaq_leased", "{{robot}} leased"),
            ("deltaq_tcp_connections", "connections over TCP"),
            ("deltaq_zenoh_sessions", "zenoh sessions"),
        ),
    ),
    (
        "Attempts refused, times in the last hour",
        "short",
        "What clients tried, and why it was refused; the audit log has each",
        (("increase(deltaq_attempts_refused_total[1h])", "{{what}} {{reason}}"),),
    ),
    (
        "Guarded messages that were not believed, a second",
        "short",
        "Forged ones, and such as were not made for this process: a few at each start",
        ((f"rate(deltaq_guarded_refused_total{_RATE})", "{{service}} {{robot}} {{cause}}"),),
    ),
)
"""Title, unit, description, and queries with their legends."""


def dashboard() -> dict[str, Any]:
    """The dashboard, as Grafana imports it."""
    return {
        "title": "deltaq",
        "uid": "deltaq",
        "schemaVersion": 39,
        "editable": True,
        "refresh": "5s",
        "time": {"from": "now-15m", "to": "now"},
        "templating": {
            "list": [{"name": "source", "label": "Prometheus", "type": "datasource", "query": "prometheus"}]
        },
        "panels": [_panel(number, *panel) for number, panel in enumerate(_PANELS)],
    }


def queries(board: dict[str, Any]) -> Iterator[str]:
    """Names of the samples that a dashboard asks for."""
    for panel in board["panels"]:
        for target in panel["targets"]:
            yield from re.findall(r"deltaq_\w+", target["expr"])


def _panel(
    number: int, title: str, unit: str, told: str, asked: tuple[tuple[str, str], ...]
) -> dict[str, Any]:
    row, column = divmod(number, _COLUMNS)
    return {
        "id": number + 1,
        "title": title,
        "description": told,
        "type": "timeseries",
        "datasource": _SOURCE,
        "fieldConfig": {"defaults": {"unit": unit, "min": 0}, "overrides": []},
        "gridPos": {"x": column * _WIDTH, "y": row * _HEIGHT, "w": _WIDTH, "h": _HEIGHT},
        "targets": [
            {
                "refId": chr(ord("A") + index),
                "datasource": _SOURCE,
                "expr": expression,
                "legendFormat": legend,
            }
            for index, (expression, legend) in enumerate(asked)
        ],
    }


def dashboard_text() -> str:
    """The file's text."""
    return json.dumps(dashboard(), indent=2) + "\n"


def main() -> None:
    """Write the file."""
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(dashboard_text(), encoding="utf-8")


if __name__ == "__main__":
    main()
