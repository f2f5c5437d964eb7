"""Compile the gate's kernel: `python -m deltaq_cell`, so that no start of a cell need.

Prints how far it is, and does nothing where all is kept from an earlier run.
"""

from pathlib import Path

from deltaq_cell.machine_code import folder, is_complete, mark_complete

_PACKAGE = Path(__file__).parent
FUNCTIONS = 120
"""About as many are compiled."""


def main() -> int:
    """Compile the gate: make a cell's bodies once and measure them."""
    where = folder(_PACKAGE)
    if not is_complete(where, "gate", _PACKAGE):
        compile_ahead()
        mark_complete(where, "gate", _PACKAGE)
    return 0


def compile_ahead() -> None:
    """Place and look at the bodies of the lab cell."""
    # large packages are imported only if something is left to compile
    from deltaq_cell.cell_model import CellModel
    from deltaq_cell.compiled_proximity import CompiledProximity
    from deltaq_cell.machine_code import compiling_shown

    with compiling_shown("the gate's kernel", FUNCTIONS):
        CompiledProximity(CellModel.load("lab"))


if __name__ == "__main__":
    raise SystemExit(main())
