"""Compile the camera's laws, so that no start of a cell has to: `python -m deltaq_controllers.camera [NAME ...]`.

Prints how far it is, and does nothing if all is stored from an earlier run.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

from deltaq_cell.machine_code import folder, is_complete, mark_complete

_PACKAGE = Path(__file__).parents[1]
_ALL = "all"
"""The functions of all controllers."""
FUNCTIONS, FUNCTIONS_OF_ALL = 140, 220
"""About as many are compiled for one law, and for all."""


def main() -> int:
    """Compile the named controllers by making each once."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_controllers.camera", description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="controllers to compile, all if none is named; no others are compiled",
    )
    names: list[str] = parser.parse_args().names
    where = folder(_PACKAGE)
    wanted = names or [_ALL]
    if all(is_complete(where, name, _PACKAGE) for name in wanted):
        return 0
    for name in {*compile_ahead(names), *wanted}:
        mark_complete(where, name, _PACKAGE)
    return 0


def compile_ahead(names: Sequence[str]) -> Sequence[str]:
    """Compile the controllers of these names, for the lab cell; all if none is named. Returns their names."""
    # heavy packages are imported only if something is left to do
    from deltaq_cell.cell_model import CellModel
    from deltaq_cell.machine_code import compiling_shown
    from deltaq_cell.roles import camera_roles
    from deltaq_controllers.camera.controllers import NAMES, camera_controller_named
    from deltaq_controllers.camera.scene import Scene

    chosen = [name for name in NAMES if not names or name in names]
    cell = CellModel.load("lab")
    roles = camera_roles(cell.description)
    scene = Scene(cell, roles.follower, roles.leader)
    with compiling_shown("the camera's laws", FUNCTIONS if len(chosen) == 1 else FUNCTIONS_OF_ALL):
        for name in chosen:
            camera_controller_named(name, scene, distance_m=1.25)
    return chosen


if __name__ == "__main__":
    raise SystemExit(main())
