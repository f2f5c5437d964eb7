"""Cells that faults are injected in: all their robots are driven over RSI."""

from __future__ import annotations

from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_testing.faults.catalogue import UnknownFaultError
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell


def load_rsi_cell(cell_name: str | Path, robot: str | None = None) -> LoadedCell:
    """Read a cell.

    Args:
        cell_name: its name or file.
        robot: one that it has to have.

    Raises:
        UnknownFaultError: if a robot has no KRC that could be emulated, or there is no such robot.
    """
    loaded = LoadedCell.load(cell_name)
    description = loaded.model.description
    for name, one in description.robots.items():
        if not isinstance(one.driver, RsiDescription):
            raise UnknownFaultError(
                f"robots.{name}.driver is {one.driver.kind!r}; faults are injected in cells whose robots are "
                "all driven over RSI: use such a cell, e.g. --cell lab"
            )
    must_have(description, robot)
    return loaded


def must_have(cell: CellDescription, robot: str | None) -> None:
    """Refuse a robot that a cell does not have; None is none in particular.

    Raises:
        UnknownFaultError: there is no such robot.
    """
    if robot is not None and robot not in cell.robots:
        raise UnknownFaultError(f"no robot {robot!r} in cell {cell.cell}; it has {', '.join(cell.robots)}")
