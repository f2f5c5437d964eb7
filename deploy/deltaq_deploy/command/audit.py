"""`deltaq audit`: who did what."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deltaq_deploy.command.options import CellOption, JsonOption

if TYPE_CHECKING:
    from collections.abc import Iterator

    from deltaq_protocol.audit import AuditEntry

_COLUMNS = (
    "time (UTC)",
    "count",
    "what",
    "outcome",
    "robot",
    "client",
    "identity",
    "address",
    "role",
    "told",
)


def audit(
    file: Annotated[
        Path | None, typer.Argument(help="File of the audit log; by default that of `deltaq up`.")
    ] = None,
    cell: CellOption = "lab",
    lines: Annotated[int, typer.Option(min=1, help="Number of entries to show, the newest ones.")] = 40,
    robot: Annotated[str | None, typer.Option(help="Only entries of this robot.")] = None,
    client: Annotated[
        str | None, typer.Option(help="Only entries of clients with this name, claimed or proved.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Show who did what: leases, stops, resets, outputs, contacts, and every refused attempt."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.command.console import console, print_table
    from deltaq_protocol.errors import DeltaqError
    from deltaq_services.hli.audit import default_audit_file, older

    path = file or default_audit_file(load_cell(cell).cell)
    if not path.exists():
        raise DeltaqError(f"there is no audit log {path}; `deltaq up` says where it writes one")
    torn = [0]
    newest_first = (
        entry
        for part in (path, *older(path))
        for entry in reversed(list(_entries(part, torn)))
        if robot in (None, entry.robot) and client in (None, entry.client, entry.identity)
    )
    shown = list(islice(newest_first, lines))[::-1]
    if json:
        for entry in shown:
            typer.echo(entry.model_dump_json())
    else:
        print_table(f"audit log {path}", _COLUMNS, map(_row, shown))
    if torn[0]:
        console_of_errors = console(typer.get_text_stream("stderr"))
        console_of_errors.print(
            f"lines that are no entries: {torn[0]}; a crash tore them, or another version wrote them"
        )


def _entries(path: Path, torn: list[int]) -> Iterator[AuditEntry]:
    """The entries of one file, oldest first; `torn` counts lines that are none."""
    from pydantic import ValidationError

    from deltaq_protocol.audit import AuditEntry

    if not path.exists():
        return
    with path.open("rb") as opened:
        for line in opened:
            try:
                yield AuditEntry.model_validate_json(line)
            except ValidationError:
                torn[0] += 1


def _row(entry: AuditEntry) -> tuple[object, ...]:
    told = f"{entry.code}: {entry.text}" if entry.code else entry.text
    return (
        entry.time_utc.removesuffix("+00:00"), entry.count, entry.what, entry.outcome, entry.robot,
        entry.client, entry.identity, entry.address, entry.role, told,
    )  # fmt: skip
