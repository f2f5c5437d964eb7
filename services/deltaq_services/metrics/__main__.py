"""`python -m deltaq_services.metrics --cell lab`."""

import argparse
import asyncio

from deltaq_cell.load import load_cell
from deltaq_services.metrics.shell import DEFAULT_PORT, Exporter
from deltaq_services.process import run


def main() -> None:
    """Serve the metrics of a cell until a signal ends the process."""
    parser = argparse.ArgumentParser(description="Metrics of a running cell, for Prometheus to read")
    parser.add_argument("--cell", default="lab", help="name or YAML file of the cell (default: lab)")
    parser.add_argument("--address", default="127.0.0.1", help="to listen on (default: 127.0.0.1)")
    parser.add_argument(
        "--port", type=int, default=DEFAULT_PORT, help=f"to listen on (default: {DEFAULT_PORT})"
    )
    given = parser.parse_args()
    asyncio.run(Exporter(load_cell(given.cell).hli).run(given.address, given.port))


if __name__ == "__main__":
    run(main, "metrics")
