"""Pages of a cell, the command and its services, the emulated KRC, criteria and gains."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import typer

from deltaq_cell import description
from deltaq_cell.load import load_cell
from deltaq_controllers.camera.clear_view import SightGains
from deltaq_controllers.camera.escape.rollout import EscapeGains
from deltaq_controllers.camera.law import FollowerGains
from deltaq_controllers.camera.qp_problem import QpGains
from deltaq_controllers.criteria import TABLE as CRITERIA
from deltaq_deploy.command.app import app
from deltaq_deploy.launch.services import cell_services, console_service, demo_controllers, recorder
from deltaq_emulator import states as krc_states
from deltaq_emulator.catalogue import TEXTS
from deltaq_emulator.settings import KrcSettings
from reference_pages import gain_sources
from reference_pages.gain_sources import GainSource
from reference_pages.markdown import field_list, fields, models, table, texts_of_members

_COMMAND_HEAD = (
    "Look up what the `deltaq` command can do, and which services it starts. `deltaq VERB --help` explains each"
    " option."
)
_EXITS = (
    "Exit status: 0 done, 1 the thing reported is bad, 2 wrong usage or configuration, 3 a service could not be"
    " reached. `--json` prints one object; a command that streams prints one object a line."
)
_SERVICES_HEAD = (
    "The lab cell's, as `deltaq up` starts them; `deltaq demo` adds leader and follower, `--record` the recorder. Each"
    " prints a line that begins with `ready:` once it serves."
)


def cell() -> str:
    """The fields of a cell's file."""
    head = (
        "# Fields of a cell\n\nLook up a field when you write a cell: a YAML file with the fields of"
        " `CellDescription`. Units are in the names. `deltaq check` names the file, line, field, value and bound of"
        " every error. A *name* has 1 to 64 characters."
    )
    return "\n\n".join(
        [head, *(fields(model, level=2) for model in models(description, description.DescriptionModel))]
    )


def cli() -> str:
    """The verbs of the command with the names of their options, and the services of the lab cell."""
    command = typer.main.get_command(app)
    verbs = "\n".join(f"- `{usage}`: {what}" for usage, what in _usages("deltaq", command))
    return "\n\n".join(
        [
            "# The deltaq command",
            _COMMAND_HEAD,
            _EXITS,
            "## Verbs",
            verbs,
            "## Services",
            _SERVICES_HEAD,
            _services(),
        ]
    )


def _usages(prefix: str, command: Any) -> Iterator[tuple[str, str]]:
    """Usage and first paragraph of each verb; typer has click's classes of its own, so none is named here."""
    for name, child in getattr(command, "commands", {}).items():
        yield from _usages(f"{prefix} {name}", child)
    if not hasattr(command, "commands") or getattr(command, "invoke_without_command", False):
        arguments = [one for one in command.params if one.param_type_name == "argument"]
        named = [one.name.upper() if one.required else f"[{one.name.upper()}]" for one in arguments]
        options = [one.opts[0] for one in command.params if one not in arguments]
        what = " ".join((command.help or "").partition("\n\n")[0].split())
        yield " ".join([prefix, *named, *options]), what


def _services() -> str:
    cell = load_cell("lab")
    services = cell_services(cell, "lab")
    rows = (
        (
            f"`{service.name}`",
            f"`python {' '.join(service.arguments)}`",
            ", ".join(f"`{name}`" for name in service.needs),
            ", ".join(f"{at.transport} {at.address}:{at.port}" for at in service.listens),
        )
        for service in (
            *services,
            console_service(cell, "lab", services),
            *demo_controllers(cell),
            recorder("lab", "run.mcap"),
        )
    )
    return table(("service", "command", "starts after", "listens on"), rows)


def krc() -> str:
    """States, settings and messages of the emulated KRC."""
    states, events = list(krc_states.KrcState), list(krc_states.KrcEvent)
    changes = (
        (f"`{state}`", f"`{event}`", f"`{to}`") for (state, event), to in krc_states.TRANSITIONS.items()
    )
    explained = "\n".join(
        f"- `{each}`: {text}"
        for of in (krc_states.KrcState, krc_states.KrcEvent)
        for each, text in zip(of, texts_of_members(of), strict=True)
    )
    return "\n\n".join(
        [
            "# The emulated KRC",
            "Look up its states, settings and messages. [What it models, from which source, and what it does"
            " not](../explanation/the-emulator.md).",
            f"## States\n\n{len(states)} states, and the {len(events)} events that change them:",
            explained,
            f"It begins with `{states[0]}`.",
            table(("state", "event", "next state"), changes),
            "## Settings",
            "Of `python -m deltaq_emulator --settings FILE.yaml`; defaults are the maker's where they are known.",
            field_list(KrcSettings),
            "## Messages on the pendant",
            "Codes that begin with KSS are the maker's numbers; the wording is not.",
            table(("code", "text"), ((f"`{code}`", text) for code, text in TEXTS.items())),
        ]
    )


def criteria() -> str:
    """The performance criteria."""
    rows = (
        (f"`{row.name}`", row.category, row.formula, row.unit, row.better, row.source) for row in CRITERIA
    )
    columns = ("name", "category", "formula", "unit", "better", "source")
    return (
        "# Performance criteria\n\nChoose what `--criterion NAME=WEIGHT` of `deltaq advise` and `deltaq drive`"
        " weighs.\n\nx is the value, and x0 its reference: the median over the robot's workspace, of clearances 0.1 m."
        " The cost is `x / (x + x0)` where less is better and `x0 / (x + x0)` where more is better: 0 is good and 1 is"
        " bad. Of several hands the worst counts. Room is distance beyond the stop distance, at most 0.25 m, between"
        " the gate's shapes; pairs whose distance follows from the hands' poses are left out. D are the joints'"
        " greatest speeds and A their accelerations.\n\nA cell's description has no joint stiffness, drive inertia or"
        " torque limits. The first two are stand-ins, and `t_j` is the torque that gives joint j its acceleration with"
        " the robot at home, M_jj a_j. So `torque`, `relative_load` and `force` compare configurations, and say"
        " nothing about what a robot can carry.\n\n" + table(columns, rows)
    )


def gains() -> str:
    """The tables of gains: the camera controllers', with their values as the code has them."""
    parts = (
        ("The paper's law", "FollowerGains", FollowerGains(), gain_sources.FOLLOWER),
        ("The quadratic programme", "QpGains", QpGains(), gain_sources.QP),
        ("The line of sight", "SightGains", SightGains(), gain_sources.SIGHT),
        ("The candidate trajectories of an escape", "EscapeGains", EscapeGains(), gain_sources.ESCAPE),
    )
    head = " ".join((gain_sources.__doc__ or "").split("\n\n", 1)[1].split())
    columns = ("gain", "value", "unit", "stands in", "value chosen by")
    return "\n\n".join(
        [
            "# Gains of the camera controllers",
            f"{head} [What they do](../explanation/camera-follower.md).",
            *(
                f"## {title}\n\n`{name}`\n\n{table(columns, _gain_rows(values, sources))}"
                for title, name, values, sources in parts
            ),
        ]
    )


def _gain_rows(values: Any, sources: Mapping[str, GainSource]) -> Iterable[tuple[str, ...]]:
    for name, value in values._asdict().items():
        yield f"`{name}`", f"{value:.4g}", *sources[name]
