"""`python -m deltaq_services.recorder --cell lab --file run.mcap`."""

import argparse
import logging
import os
import signal
import threading
from pathlib import Path

from deltaq_cell.load import load_cell
from deltaq_services.process import run
from deltaq_services.recorder.shell import Recorder

_log = logging.getLogger(__name__)


def main() -> None:
    """Record a running cell until a signal ends the process."""
    parser = argparse.ArgumentParser(
        description="Recorder: writes the messages of a running cell to an MCAP file"
    )
    parser.add_argument("--cell", default="lab", help="name or YAML file of the cell (default: lab)")
    parser.add_argument("--file", required=True, type=Path, help="file to write; it must not exist")
    parser.add_argument(
        "--until-input-ends",
        action="store_true",
        help="end when the parent process closes its input, or ends",
    )
    options = parser.parse_args()
    if options.until_input_ends:
        threading.Thread(target=_end_with_input, daemon=True).start()
    with Recorder(load_cell(options.cell), options.file) as recorder:
        _log.info("ready: recorder writes %s", options.file)
        recorder.run()


def _end_with_input() -> None:
    """End this process as SIGTERM does, when its input has ended."""
    # not `sys.stdin`, whose lock this thread would hold as the interpreter ends
    while os.read(0, 4096):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    run(main, "recorder")
