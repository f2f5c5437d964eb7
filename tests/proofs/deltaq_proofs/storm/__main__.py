"""Attack the RSI wire of a moving robot: `python -m deltaq_proofs.storm --telegrams 1000000`.

Every reply of its Robot Server has to be explained.

Exit status: 0 every correction is explained, 1 one is not.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import asdict

from deltaq_deploy.launch.program import run_program
from deltaq_proofs.storm.run import StormReport, run_storm
from deltaq_testing.faults.panel import load_rsi_cell


def main(arguments: list[str] | None = None) -> int:
    """Run one storm; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_proofs.storm",
        description="Attack RSI's wire of a moving robot with datagrams; every reply has to be explained.",
    )
    parser.add_argument("--cell", default="lab", help="a cell that is not up; it is started")
    parser.add_argument("--robot", default="fr", help="whose wire is attacked")
    parser.add_argument("--telegrams", type=int, default=1_000_000, help="datagrams that the attacker sends")
    parser.add_argument("--rate-hz", type=float, default=2500.0, help="how many of them a second")
    parser.add_argument("--seed", type=int, default=0, help="of the attacker")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")
    given = parser.parse_args(arguments)
    if given.telegrams < 1:
        parser.error(f"--telegrams {given.telegrams}: at least 1")
    if not 0.0 < given.rate_hz < math.inf:
        parser.error(f"--rate-hz {given.rate_hz:g}: more than 0")
    loaded = load_rsi_cell(given.cell, given.robot)
    progress = None if given.json else _tell
    report = run_storm(loaded, given.robot, given.telegrams, given.rate_hz, given.seed, progress)
    print(json.dumps(asdict(report)) if given.json else _text(report))
    return 0 if report.unexplained is None else 1


def _tell(forged: int) -> None:
    print(f"\r{forged} datagrams", end="", file=sys.stderr, flush=True)


def _text(report: StormReport) -> str:
    rate = report.forged / report.duration_s
    lines = [f"\n{report.forged} datagrams of the attacker in {report.duration_s:.0f} s, {rate:.0f} a second"]
    tables = {
        "sent": report.sent,
        "replies": report.replies,
        "operator": report.operator,
        "Robot Server": report.server,
    }
    for title, table in tables.items():
        lines += ["", f"{title}:", *(f"{count:9d}  {what}" for what, count in sorted(table.items()))]
    lines += [
        "",
        f"admissions heard: {report.admissions}, lost on their way to the witness: {report.unheard}",
    ]
    lines += ["", f"unexplained: {report.unexplained or 'nothing'}"]
    return "\n".join(lines)


if __name__ == "__main__":
    run_program(main, "deltaq_proofs.storm")
