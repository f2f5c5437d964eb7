"""`python -m deltaq_services.console --cell lab`."""

import argparse
import os
from pathlib import Path

from deltaq_cell.load import load_cell
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.given_token import OPERATOR_TOKEN, given_token
from deltaq_protocol.role_prover import environment_has_role
from deltaq_services.console.settings import CONSOLE_TOKEN, Settings
from deltaq_services.process import run


class NotInstalledError(DeltaqError):
    """A library of the console's server is not installed."""


def main() -> None:
    """Serve the console until a signal ends the process."""
    parser = argparse.ArgumentParser(
        description="Console: the page in a browser from which an operator watches and drives the robots"
    )
    parser.add_argument("--cell", default="lab", help="name or YAML file of the cell (default: lab)")
    parser.add_argument("--address", help="to be reached at (default: the cell's console_address)")
    parser.add_argument("--port", type=int, help="to be reached at (default: the cell's console_port)")
    parser.add_argument("--emulated", action="store_true", help="no robot of the cell is real")
    parser.add_argument("--recordings", type=Path, help="folder in which recordings are written and opened")
    options = parser.parse_args()
    description = load_cell(options.cell)
    settings = Settings(
        cell=options.cell,
        emulated=options.emulated,
        address=options.address or description.console_address,
        port=options.port if options.port is not None else description.console_port,
        token=given_token(CONSOLE_TOKEN) or "",
        operator_token=given_token(OPERATOR_TOKEN),
        has_role=environment_has_role(os.environ),
        recordings=options.recordings,
    )
    # after the settings were found good: this import takes seconds
    try:
        from deltaq_services.console.web import serve
    except ModuleNotFoundError as error:
        raise NotInstalledError(f"{error.name} is not installed: pip install 'deltaq[console]'") from error
    serve(settings)


if __name__ == "__main__":
    run(main, "console")
