"""Pages of a cell, its services and robots, gains, criteria, and the command."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from inspect import getdoc
from typing import Any

import typer
from typer.cli import get_docs_for_click

from deltaq_cell import description
from deltaq_cell.load import load_cell
from deltaq_controllers.camera import gain_sources
from deltaq_controllers.camera.clear_view import SightGains
from deltaq_controllers.camera.escape.gains import EscapeGains
from deltaq_controllers.camera.gain_sources import GainSource
from deltaq_controllers.camera.gains import FollowerGains, Variants
from deltaq_controllers.camera.qp_gains import QpGains
from deltaq_controllers.criteria import TABLE as CRITERIA
from deltaq_deploy.command.app import app
from deltaq_deploy.launch.services import cell_services, console_service, demo_controllers, recorder
from deltaq_emulator import states as krc_states
from deltaq_emulator.catalogue import TEXTS
from deltaq_emulator.settings import KrcSettings
from deltaq_protocol.messages import Phase
from deltaq_services.phases import MAY_MOVE, TRANSITIONS, Event
from deltaq_services.robot_server import session
from reference_pages.markdown import bounds, default, fields, models, table, texts_of_members, type_name


def phases() -> str:
    """The phases of a robot, with their picture."""
    arrows = [f"    {row.phase} --> {row.next_phase}: {row.event}" for row in TRANSITIONS]
    diagram = "\n".join(["stateDiagram-v2", f"    [*] --> {Phase.OFFLINE}", *arrows])
    explained = ((f"`{event}`", text) for event, text in zip(Event, texts_of_members(Event), strict=True))
    rows = ((f"`{row.phase}`", f"`{row.event}`", f"`{row.next_phase}`") for row in TRANSITIONS)
    may_move = ", ".join(f"`{phase}`" for phase in Phase if phase in MAY_MOVE)
    return "\n\n".join(
        [
            "# Phases of a robot",
            "The Robot Server runs from this table; an event without a row for the present phase changes nothing."
            f" Admissions are taken in {may_move} only."
            " [What is proved of it](../explanation/what-is-proved-of-the-phases.md).",
            f"```mermaid\n{diagram}\n```",
            table(("phase", "event", "next phase"), rows),
            table(("event", "when"), explained),
        ]
    )


def krc() -> str:
    """States, settings and messages of the emulated KRC."""
    states, events = list(krc_states.KrcState), list(krc_states.KrcEvent)
    arrows = [
        f"    s{states.index(state)} --> s{states.index(to)}: {event}"
        for (state, event), to in krc_states.TRANSITIONS.items()
    ]
    names = [f"    s{number}: {state}" for number, state in enumerate(states)]
    rows = ((f"`{state}`", f"`{event}`", f"`{to}`") for (state, event), to in krc_states.TRANSITIONS.items())
    explained = [
        table((kind, "what it is"), ((f"`{each}`", text) for each, text in zip(of, texts, strict=True)))
        for kind, of, texts in (
            ("state", states, texts_of_members(krc_states.KrcState)),
            ("event", events, texts_of_members(krc_states.KrcEvent)),
        )
    ]
    settings = (
        (f"`{name}`", f"`{type_name(field.annotation)}`", bounds(field), default(field), text)
        for (name, field), text in zip(
            KrcSettings.model_fields.items(), texts_of_members(KrcSettings, fields=True), strict=True
        )
    )
    pendant = ((f"`{code}`", text) for code, text in TEXTS.items())
    return "\n\n".join(
        [
            "# The emulated KRC",
            "[What it models, from which source, and what it does not](../explanation/the-emulator.md).",
            "## States",
            "\n".join(
                [
                    "```mermaid",
                    "stateDiagram-v2",
                    *names,
                    f"    [*] --> s{states.index(states[0])}",
                    *arrows,
                    "```",
                ]
            ),
            explained[0],
            explained[1],
            table(("state", "event", "next state"), rows),
            "## Settings",
            "Of `python -m deltaq_emulator --settings FILE.yaml`; defaults are the maker's where they are known.",
            table(("setting", "type", "bounds", "default", "meaning"), settings),
            "## Messages on the pendant",
            "Codes that begin with KSS are the maker's numbers; the wording is not.",
            table(("code", "text"), pendant),
        ]
    )


def sessions() -> str:
    """What a Robot Server believes of a KRC's session."""
    rows = (
        (f"`{row.belief}`", f"`{row.kind}`", f"`{row.answer}`", f"`{row.next_belief}`")
        for row in session.AUTOMATON
    )
    tables = [
        table(
            (name, "meaning"),
            ((f"`{one}`", text) for one, text in zip(members, texts_of_members(members), strict=True)),
        )
        for name, members in (
            ("belief", session.Belief),
            ("telegram", session.TelegramKind),
            ("answer", session.Answer),
        )
    ]
    return "\n\n".join(
        [
            "# Sessions of a KRC",
            f"A session is believed after {session.CONFIRMATIONS} telegrams in a row that agree and stand still, and "
            f"come no faster than {1 / session.PACE:g} times their own pace."
            " [What else is believed of a telegram, and why](../explanation/the-last-metre.md).",
            table(("belief", "telegram", "answer", "next belief"), rows),
            *tables,
        ]
    )


def criteria() -> str:
    """The performance criteria."""
    rows = (
        (f"`{row.name}`", row.category, row.formula, row.unit, row.better, row.source) for row in CRITERIA
    )
    columns = ("name", "category", "formula", "unit", "better", "source")
    return (
        "# Performance criteria\n\nWhat `--criterion NAME=WEIGHT` weighs, "
        "of `deltaq advise` and `deltaq drive`. With x the value and x0 its "
        "reference the cost is `x / (x + x0)` where less is better and `x0 / (x + x0)` where more is, so that 0 is "
        "good and 1 bad; the reference is the median over the robot's workspace, of clearances 0.1 m. Of several "
        "hands the worst counts. Room is distance beyond the stop distance, by the gate's shapes, without pairs "
        "whose distance the hands' poses fix; more than 0.25 m counts as that. D are the joints' greatest speeds and "
        "A their accelerations.\n\nA cell's description has no joint stiffness, inertia of drives or torque limits: "
        "the first two are stand-ins, and `t_j` is the torque that gives joint j its acceleration with the robot "
        "at home, M_jj a_j. So `torque`, `relative_load` and `force` compare configurations, and say nothing "
        "of what a robot can carry.\n\n" + table(columns, rows)
    )


def cell() -> str:
    """The fields of a cell's file."""
    head = (
        "# Fields of a cell\n\nA cell is a YAML file with the fields of `CellDescription`; `deltaq check` says what is"
        " wrong with one. Units are in the names of the fields."
    )
    return "\n\n".join(
        [head, *(fields(model, level=2) for model in models(description, description.DescriptionModel))]
    )


def services() -> str:
    """The services of the lab cell, as they are started."""
    cell = load_cell("lab")
    rows = (
        (
            f"`{service.name}`",
            f"`python {' '.join(service.arguments)}`",
            ", ".join(f"`{name}`" for name in service.needs),
            ", ".join(f"{at.transport} {at.address}:{at.port}" for at in service.listens),
            service.probe,
        )
        for service in (
            *cell_services(cell, "lab"),
            console_service(cell, "lab", cell_services(cell, "lab")),
            *demo_controllers(cell),
            recorder("lab", "run.mcap"),
        )
    )
    return (
        "# Services\n\nThe lab cell's, as `deltaq up` starts them; leader and follower belong to `deltaq demo`, the"
        " console is left out by `--no-console`, the recorder belongs to `deltaq up --record`. Each"
        " prints one line that begins with `ready:` once it serves.\n\n"
        + table(("service", "command", "starts after", "listens on", "asked for health by"), rows)
    )


def cli() -> str:
    """The command's help, as typer renders it."""
    command = typer.main.get_command(app)
    text = get_docs_for_click(
        obj=command, ctx=typer.Context(command), name="deltaq", title="The deltaq command"
    )
    exits = (
        "Exit status: 0 done, 1 the thing reported is bad, 2 wrong usage or configuration, 3 a service could not be"
        " reached.\n\n**Usage**"
    )
    return text.replace("**Usage**", exits, 1)


_HEAD = ("gain", "value", "unit", "stands in", "value chosen by")


def gains() -> str:
    """The tables of gains."""
    variants = getdoc(Variants) or ""
    return "\n\n".join(
        [
            "# Gains of the camera controllers",
            " ".join((gain_sources.__doc__ or "").split("\n\n", 1)[1].split())
            + " [What they do](../explanation/camera-follower.md).",
            "## The paper's law",
            "`FollowerGains`: `paper`, `predictive` and the variants as printed.",
            table(_HEAD, _rows(FollowerGains(), gain_sources.FOLLOWER)),
            " ".join(variants.split("\n\nAttributes:")[0].split("\n\n", 1)[1].split()),
            "## The quadratic programme",
            "`QpGains`: `qp`.",
            table(_HEAD, _rows(QpGains(), gain_sources.QP)),
            "## The line of sight",
            "`SightGains`: `clear-view`, which has those of `qp` besides.",
            table(_HEAD, _rows(SightGains(), gain_sources.SIGHT)),
            "## The courses of an escape",
            "`EscapeGains`: `escape`, which has those of `qp` besides.",
            table(_HEAD, _rows(EscapeGains(), gain_sources.ESCAPE)),
        ]
    )


def _rows(values: Any, sources: Mapping[str, GainSource]) -> Iterable[tuple[str, ...]]:
    for name, value in values._asdict().items():
        yield f"`{name}`", f"{value:.4g}", *sources[name]
