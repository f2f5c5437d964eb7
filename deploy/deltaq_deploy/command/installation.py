"""Verbs about files and the machine: check, schema, keys and doctor."""

from __future__ import annotations

import os
from dataclasses import asdict, replace
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaq_deploy.command.console import print_json, print_table
from deltaq_deploy.command.options import CellOption, JsonOption
from deltaq_deploy.command.streams import by_name
from deltaq_deploy.launch import BAD

if TYPE_CHECKING:
    from deltaq_cell.check import CheckReport


# The verb that makes identities: one for each service of a cell, its operators and its controllers.

KEEP = (
    "Who has its key can make identities of this cell: take the folder off this machine, and bring it back for "
    "the next `deltaq keys`"
)


def _identity_of(whom: str) -> Any:
    return typer.Option(metavar="NAME", help=f"Make an identity for this {whom}; repeatable.")


AuthorityOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FOLDER",
        help="Folder of the authority's key.",
        show_default="authority in the folder of --output",
    ),
]


def keys(
    output: Annotated[
        Path, typer.Option(metavar="PATH", help="Folder for the identities; with --secret the file.")
    ],
    cell: CellOption = "lab",
    operator: Annotated[list[str] | None, _identity_of("operator")] = None,
    controller: Annotated[list[str] | None, _identity_of("controller")] = None,
    authority: AuthorityOption = None,
    days: Annotated[
        int, typer.Option(min=1, max=3650, help="Days for which the identities are valid.")
    ] = 730,
    secret: Annotated[
        bool,
        typer.Option(
            "--secret", help="Make a random secret instead, such as a token, that only its owner may read."
        ),
    ] = False,
    keep: Annotated[
        bool, typer.Option("--keep", help="With --secret: keep one that exists already.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Make an authority for a cell, and an identity for each of its services, operators and controllers.

    Each identity is a folder for the machine that needs it. The command makes missing identities, and overwrites
    nothing.
    """
    if secret:
        _make_secret(output, keep)
        return

    from deltaq_cell.load import load_cell
    from deltaq_protocol.certified.authority import make_identities
    from deltaq_protocol.certified.certificate import now_utc
    from deltaq_protocol.certified.names import IDENTITY, IdentityKind, name_of
    from deltaq_protocol.sayings import services

    description = load_cell(cell)
    people = [name_of(IdentityKind.OPERATOR, name) for name in operator or ()]
    people += [name_of(IdentityKind.CONTROLLER, name) for name in controller or ()]
    of_cell = [name_of(IdentityKind.SERVICE, name) for name in services(tuple(description.robots))]
    made = make_identities(
        description.cell, output, of_cell, dict.fromkeys(people), now_utc(), authority, timedelta(days=days)
    )
    if json:
        print_json(
            {
                "cell": description.cell,
                "authority": str(made.authority),
                "authority_is_new": made.is_new,
                "made": {name: str(output / name) for name in made.made},
                "kept": list(made.kept),
                "valid_until": f"{made.valid_until:%Y-%m-%dT%H:%M:%SZ}",
            }
        )
        return
    for name in made.made:
        typer.echo(f"{output / name}: {name} of cell {description.cell}")
    for name in made.kept:
        typer.echo(f"{name}: exists already; kept")
    if made.made:
        typer.echo(f"valid until {made.valid_until:%Y-%m-%d}; on each machine {IDENTITY} names its folder")
    typer.echo(f"{made.authority}: the authority. {KEEP}")


def check(
    cell: CellOption = "lab",
    verbose: Annotated[
        bool,
        typer.Option(
            "--verbose", help="Also list the bodies that are never checked against each other, and why."
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Check the description of a cell; name file, line, field, value and bound of every error."""
    from deltaq_cell.check import check_cell

    report, equipment = _with_equipment(_with_identity(check_cell(cell)))
    if json:
        print_json(report.as_dict() | {"equipment": equipment})
    else:
        for problem in report.problems:
            typer.echo(f"{problem.severity}: {problem}")
        if not report.problems:
            typer.echo(f"{cell}: good")
        if equipment:
            kinds = ", ".join(f"{name} ({kind})" for name, kind in equipment.items())
            typer.echo(f"equipment, see `deltaq routine list`: {kinds}")
        if verbose:
            _show_never_checked(report)
    if not report.ok:
        raise typer.Exit(BAD)


def _show_never_checked(report: CheckReport) -> None:
    from deltaq_cell.never_checked import Why

    for robot, pairs in report.never_checked.items():
        for why in dict.fromkeys(pairs.values()):
            if why is Why.ONE_LINK:  # dozens where a gripper is modelled in parts; --json names them
                typer.echo(f"{robot}: never checked, since {why}: {list(pairs.values()).count(why)} pairs")
                continue
            named = [
                " - ".join(name.removeprefix(f"{robot}/") for name in p) for p in pairs if pairs[p] is why
            ]
            typer.echo(f"{robot}: never checked, since {why}: {', '.join(named)}")


def _with_identity(report: CheckReport) -> CheckReport:
    """The same findings, with the faults of the identity that the environment names."""
    from deltaq_cell.load import load_cell
    from deltaq_cell.problems import Problem
    from deltaq_protocol.certified.names import IDENTITY

    named = os.environ.get(IDENTITY)
    if not report.ok or not named:
        return report
    from deltaq_services.service_identity import identity_faults

    faults = identity_faults(load_cell(report.cell), Path(named))
    found = [Problem(IDENTITY, 0, "", text, severity=severity) for severity, text in faults]
    return replace(report, problems=(*report.problems, *found))


def _with_equipment(report: CheckReport) -> tuple[CheckReport, dict[str, str]]:
    """The same findings, with the equipment that its robot cannot work on; and the kind of each item by name."""
    from deltaq_cell.cell_model import CellModel
    from deltaq_cell.load import load_located
    from deltaq_cell.yaml_tree import PlacedProblems

    if not report.ok:
        return report, {}
    description, tree = load_located(report.cell)
    kinds = {name: item.kind for name, item in description.equipment.items()}
    if not kinds:
        return report, {}
    from deltaq_controllers.routines.planner import unreachable

    placed = PlacedProblems(tree)
    found = unreachable(CellModel.load(report.cell))
    faults = [placed.at(("equipment", name, "approach"), why) for name, why in found.items()]
    return replace(report, problems=(*report.problems, *faults)), dict(kinds)


def schema(
    topic: Annotated[str | None, typer.Argument(help="Only this topic.", show_default=False)] = None,
) -> None:
    """Print the JSON Schema of every message, enough to write a controller in another language."""
    import json

    from deltaq_protocol.topics import TOPICS

    chosen = TOPICS if topic is None else (by_name(topic),)
    document: dict[str, Any] = {
        row.name: {
            "key": row.template,
            "realm": row.realm.value,
            "kind": row.kind.value,
            "publishers": [party.value for party in row.publishers],
            "readers": [party.value for party in row.readers],
            "rate": row.rate_text,
            "max_age_cycles": row.max_age_cycles,
            "max_age_s": row.max_age_s,
            "priority": row.priority.value,
            "message": row.message.model_json_schema(),
            "reply": row.reply.model_json_schema() if row.reply else None,
        }
        for row in chosen
    }
    if topic is None:
        document["json-lines"] = _lines()
    typer.echo(json.dumps(document, indent=2))


def _lines() -> dict[str, Any]:
    from deltaq_protocol import messages

    types = (messages.Hello, messages.Welcome, messages.Error, messages.Done)
    return {"only over TCP": [message.model_json_schema() for message in types]}


def _make_secret(file: Path, keep: bool) -> None:
    from deltaq_deploy.launch.given_tokens import write_new_secret

    write_new_secret(file, keep=keep)
    typer.echo(f"{file}: give its path as a token's, for example in DELTAQ_OPERATOR_TOKEN_FILE")


def doctor(cell: CellOption = "lab", json: JsonOption = False) -> None:
    """Report whether this machine is fit to run a cell, and what would improve it."""
    from deltaq_cell.load import load_cell
    from deltaq_deploy.launch.doctor import Rating, examine

    findings = examine(load_cell(cell), cell)
    bad = any(finding.verdict is Rating.BAD for finding in findings)
    if json:
        print_json({"fit": not bad, "findings": [asdict(finding) for finding in findings]})
    else:
        print_table(
            "this machine",
            ("what", "found", "verdict", "advice"),
            ((finding.what, finding.found, finding.verdict, finding.advice) for finding in findings),
        )
    if bad:
        raise typer.Exit(BAD)
