"""`deltaq status`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deltaq_deploy.cli.options import CellOption, JsonOption

if TYPE_CHECKING:
    from deltaq_cell.description import CellDescription
    from deltaq_protocol.messages import Status


def status(cell: CellOption = "lab", json: JsonOption = False) -> None:
    """Show a running cell: phases, leases, age of data, what the gate decided, the nearest pair."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.cli.console import print_json
    from deltaq_deploy.running import connect

    description = load_cell(cell)
    with connect(description, "deltaq status") as running:
        answer = running.status()
    if json:
        print_json(answer.model_dump(mode="json"))
    else:
        show(answer, description)


def show(answer: Status, cell: CellDescription) -> None:
    """Print a status as people read it."""
    from deltaq_deploy.cli.console import counts, degrees_or_millimetres, print_table

    rows = []
    for name, robot in answer.robots.items():
        units = cell.robots[name].units if name in cell.robots else ()
        q = " ".join(degrees_or_millimetres(*joint) for joint in zip(robot.q, units, strict=False))
        age = None if robot.state_age_s is None else f"{robot.state_age_s * 1000:.0f} ms"
        rows.append((name, robot.phase, robot.reason, robot.cycle, age, robot.lease.holder, q))
    print_table(
        f"cell {answer.cell}", ("robot", "phase", "reason", "cycle", "age", "leased by", "joints"), rows
    )
    gate_age = "silent" if answer.gate_age_s is None else f"{answer.gate_age_s:.1f} s ago"
    print(f"gate ({gate_age}): {counts(answer.gate)}")
    print(f"hli: {counts(answer.hli)}")
    for name, robot in answer.robots.items():
        print(f"{name}: {counts(robot.counters)}")
    if answer.nearest is not None:
        print(f"nearest: {' and '.join(answer.nearest.pair)}, {answer.nearest.distance_m * 1000:.0f} mm")
