"""`deltaq doctor`."""

from __future__ import annotations

import typer

from deltaq_command.errors import BAD
from deltaq_command.options import CellOption, JsonOption


def doctor(cell: CellOption = "lab", json: JsonOption = False) -> None:
    """Report whether this machine is fit to run a cell, and what would improve it."""
    from dataclasses import asdict

    from deltaq_cell.load import load_cell
    from deltaq_command.console import print_json, print_table
    from deltaq_launch.doctor import examine
    from deltaq_launch.findings import Verdict

    findings = examine(load_cell(cell), cell)
    bad = any(finding.verdict is Verdict.BAD for finding in findings)
    if json:
        print_json({"fit": not bad, "findings": [asdict(finding) for finding in findings]})
    else:
        print_table(
            "this machine",
            ("what", "found", "verdict", "advice"),
            ((finding.what, finding.found, finding.verdict, finding.advice) for finding in findings),
        )
    if bad:
        raise typer.Exit(BAD)
