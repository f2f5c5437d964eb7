"""`deltaq status`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from deltaq_command.options import CellOption, JsonOption, UrlOption

if TYPE_CHECKING:
    from rich.console import Group

    from deltaq_protocol.messages import Description, Status


def status(cell: CellOption = "lab", url: UrlOption = None, json: JsonOption = False) -> None:
    """Show a running cell: phases, leases, age of data, what the gate decided, the nearest pair."""
    from deltaq_command.console import PIPE_WIDTH, console, print_json
    from deltaq_launch.cell_connection import Where, connect

    with connect(Where.of(cell, url), "deltaq status") as running:
        answer, description = running.status(), running.description
    if json:
        print_json(answer.model_dump(mode="json"))
    else:
        target = console()
        if not target.is_terminal:
            target.width = PIPE_WIDTH
        target.print(shown(answer, description))


def shown(answer: Status, cell: Description) -> Group:
    """A status for people."""
    from rich.console import Group
    from rich.text import Text

    from deltaq_command.console import counts, degrees_or_millimetres, table_of

    rows = []
    for name, robot in answer.robots.items():
        units = cell.robots[name].units if name in cell.robots else ()
        q = " ".join(degrees_or_millimetres(*joint) for joint in zip(robot.q, units, strict=False))
        age = None if robot.state_age_s is None else f"{robot.state_age_s * 1000:.0f} ms"
        rows.append((name, robot.phase, robot.reason, robot.cycle, age, robot.lease.holder, q))
    columns = ("robot", "phase", "reason", "cycle", "age", "leased by", "joints")
    gate_age = "silent" if answer.gate_age_s is None else f"{answer.gate_age_s:.1f} s ago"
    lines = [f"gate ({gate_age}): {counts(answer.gate)}", f"hli: {counts(answer.hli)}"]
    lines += [f"{name}: {counts(robot.counters)}" for name, robot in answer.robots.items()]
    if answer.contacts:
        lines.append(f"contacts allowed: {', '.join(answer.contacts)}")
    lines += [f"another cell: {said}" for said in answer.mismatches]
    lines += [f"lagging: {fault}" for fault in answer.lagging]
    if answer.nearest is not None:
        pair = " and ".join(answer.nearest.pair)
        lines.append(f"nearest: {pair}, {answer.nearest.distance_m * 1000:.0f} mm")
    return Group(table_of(f"cell {answer.identity or answer.cell}", columns, rows), *map(Text, lines))
