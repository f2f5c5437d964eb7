"""`python -m deltaq_services.recorder --cell lab --file run.mcap`."""

from __future__ import annotations

import argparse
from pathlib import Path

from deltaq_cell.load import load_cell
from deltaq_services.process import run
from deltaq_services.recorder.shell import Recorder


def main() -> None:
    """Record a running cell until a signal ends the process."""
    parser = argparse.ArgumentParser(
        description="Recorder: writes the messages of a running cell to an MCAP file"
    )
    parser.add_argument("--cell", default="lab", help="name or YAML file of the cell (default: lab)")
    parser.add_argument("--file", required=True, type=Path, help="file to write; it must not exist")
    options = parser.parse_args()
    with Recorder(load_cell(options.cell), options.file) as recorder:
        print(f"ready: recorder writes {options.file}", flush=True)
        recorder.run()


if __name__ == "__main__":
    run(main)
