"""Let a robot suffer fault after fault over real processes, zenoh and UDP: `python -m studies.live_faults`."""

import argparse
from collections.abc import Sequence

from deltaq_deploy.launch.program import run_program
from deltaq_testing.faults.catalogue import CATALOGUE, fault_named
from deltaq_testing.faults.virtual import markdown
from studies.live_faults.run import live_table


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the faults and print the table; returns 1 if a limit was passed or the robot never moved again."""
    parser = argparse.ArgumentParser(prog="python -m studies.live_faults", description=__doc__)
    parser.add_argument("names", nargs="*", help="faults to inject (default: all)")
    parser.add_argument(
        "--cell", default="lab", help="name or file; it must not be up (default: %(default)s)"
    )
    parser.add_argument("--robot", default=None, help="the robot that moves (default: the cell's first)")
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the links' faults (default: %(default)s)"
    )
    given = parser.parse_args(arguments)
    faults = [fault_named(name) for name in given.names] or CATALOGUE
    table = live_table(given.cell, given.robot, faults, given.seed)
    print(markdown(table))
    return int(not table.good)


if __name__ == "__main__":
    run_program(main, "studies.live_faults")
