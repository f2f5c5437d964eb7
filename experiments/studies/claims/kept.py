"""Reports of runs in a folder, so that a long series can be interrupted."""

from __future__ import annotations

import json
from pathlib import Path

from studies.claims.claim import Claim, JsonReport


class KeptReports:
    """A report for each run, in a file whose name says which.

    Args:
        folder: where they are kept; None: nowhere.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        if folder is not None:
            folder.mkdir(parents=True, exist_ok=True)

    def get(self, claim: Claim, seed: int) -> JsonReport | None:
        """The report of a run, if it was kept."""
        file = self._file(claim, seed)
        if file is None or not file.exists():
            return None
        report: JsonReport = json.loads(file.read_text(encoding="utf-8"))
        return report

    def put(self, claim: Claim, seed: int, report: JsonReport) -> JsonReport:
        """Keep the report of a run; returns it."""
        file = self._file(claim, seed)
        if file is not None:
            file.write_text(json.dumps(report), encoding="utf-8")
        return report

    def _file(self, claim: Claim, seed: int) -> Path | None:
        words = claim.command.removeprefix("deltaq experiment ").replace("--", "").split()
        return None if self._folder is None else self._folder / f"{'-'.join(words)}-seed-{seed}.json"
