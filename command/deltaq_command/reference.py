"""Writes `docs/reference` from the code: `python -m deltaq_command.reference`.

Every page follows from a table or a model, so that none can fall behind; a test holds the committed pages.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable
from enum import Enum
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from typer.cli import get_docs_for_click

from deltaq_cell import description
from deltaq_cell.load import load_cell
from deltaq_command.app import app
from deltaq_controllers.criteria import TABLE as CRITERIA
from deltaq_emulator import states as krc_states
from deltaq_emulator.catalogue import TEXTS
from deltaq_emulator.settings import KrcSettings
from deltaq_launch.services import cell_services, demo_controllers, recorder
from deltaq_protocol import guarded, messages, topics
from deltaq_protocol.messages import Message, Phase
from deltaq_protocol.reasons import EXPLANATIONS
from deltaq_services.counters import COUNTERS
from deltaq_services.phases import MAY_MOVE, TRANSITIONS, Event
from deltaq_services.robot_server import session

FOLDER = Path(__file__).parents[2] / "docs" / "reference"
WRITTEN = "<!-- Written by `make docs` from the code; do not edit. -->\n\n"
_SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤", "min_length": "length ≥", "max_length": "length ≤"}


def pages() -> dict[str, str]:
    """Every page by file name."""
    texts = {
        "topics.md": _topics(),
        "messages.md": _messages(),
        "reasons.md": _reasons(),
        "counters.md": _counters(),
        "phases.md": _phases(),
        "krc.md": _krc(),
        "rsi-sessions.md": _sessions(),
        "criteria.md": _criteria(),
        "cell.md": _cell(),
        "services.md": _services(),
        "cli.md": _cli(),
    }
    return {name: WRITTEN + text.rstrip() + "\n" for name, text in texts.items()}


def _topics() -> str:
    rows = (
        (
            f"`{topic.name}`",
            topic.realm,
            topic.kind,
            f"`{topic.template}`",
            _message_link(topic.message) + (f" → {_message_link(topic.reply)}" if topic.reply else ""),
            ", ".join(topic.publishers),
            ", ".join(topic.readers),
            topic.rate_text,
            topic.max_age_cycles,
            topic.max_age_s,
            topic.priority,
            topic.recorded,
        )
        for topic in topics.TOPICS
    )
    columns = (
        *("topic", "realm", "kind", "key", "message", "published or asked by", "read or answered by"),
        *("rate", "greatest age [cycles]", "greatest age [s]", "priority", "recorded"),
    )
    return (
        "# Topics\n\nzenoh carries msgpack maps with the fields of the message named. Clients reach the open realm;"
        " HLI, SIM and Robot Servers alone speak in the guarded realm. What is older than its greatest age is not"
        " acted upon; where the cell's `gate` bounds an age in seconds too (`max_request_age_s`), the lesser of"
        " the two decides. See [the loop](../explanation/the-loop.md).\n\n" + _table(columns, rows)
    )


def _messages() -> str:
    parts = [
        "# Messages\n\nThe fields are the same in msgpack and in JSON lines; `deltaq schema` prints them as JSON"
        " Schema. `q` is a configuration and `dq` an increment over one cycle, in rad and m, in joint order."
    ]
    for module, realm in ((messages, "Open realm"), (guarded, "Guarded realm")):
        parts.append(f"## {realm}")
        parts += [_model(model, level=3) for model in _models(module, Message)]
    return "\n\n".join(parts)


def _reasons() -> str:
    rows = ((f"`{code}`", text) for code, text in EXPLANATIONS.items())
    return (
        "# Reason codes\n\nWhy a request was scaled, held or refused, and why a robot is held.\n\n"
        + _table(("code", "meaning"), rows)
    )


def _counters() -> str:
    rows = ((row.service.replace("_", " "), f"`{row.name}`", row.meaning) for row in COUNTERS)
    return (
        "# Counters\n\nWhat `deltaq status --json` and the states of the guarded realm count, each from the start of"
        " its process; what never happened is left out. A part in braces is filled in: a [reason code](reasons.md), a"
        " [topic](topics.md), a robot.\n\n" + _table(("service", "counter", "what was counted"), rows)
    )


def _criteria() -> str:
    rows = (
        (f"`{row.name}`", row.category, row.formula, row.unit, row.better, row.source) for row in CRITERIA
    )
    columns = ("name", "category", "formula", "unit", "better", "source")
    return (
        "# Performance criteria\n\nWhat `--criterion NAME=WEIGHT` weighs, "
        "of `deltaq advise` and `deltaq drive`. With x the value and x0 its "
        "reference the cost is `x / (x + x0)` where less is better and `x0 / (x + x0)` where more is, so that 0 is "
        "good and 1 bad; the reference is the median over the robot's workspace, of `clearance` 0.1 m. Of several "
        "hands the mean counts. Joint stiffness and the inertia of the drives are stand-ins.\n\n"
        + _table(columns, rows)
    )


def _phases() -> str:
    arrows = [f"    {row.phase} --> {row.next_phase}: {row.event}" for row in TRANSITIONS]
    diagram = "\n".join(["stateDiagram-v2", f"    [*] --> {Phase.OFFLINE}", *arrows])
    explained = ((f"`{event}`", text) for event, text in zip(Event, _texts_of_members(Event), strict=True))
    rows = ((f"`{row.phase}`", f"`{row.event}`", f"`{row.next_phase}`") for row in TRANSITIONS)
    may_move = ", ".join(f"`{phase}`" for phase in Phase if phase in MAY_MOVE)
    return "\n\n".join(
        [
            "# Phases of a robot",
            "The Robot Server runs from this table; an event without a row for the present phase changes nothing."
            f" Admissions are taken in {may_move} only."
            " [What is proved of it](../explanation/what-is-proved-of-the-phases.md).",
            f"```mermaid\n{diagram}\n```",
            _table(("phase", "event", "next phase"), rows),
            _table(("event", "when"), explained),
        ]
    )


def _krc() -> str:
    states, events = list(krc_states.KrcState), list(krc_states.KrcEvent)
    arrows = [
        f"    s{states.index(state)} --> s{states.index(to)}: {event}"
        for (state, event), to in krc_states.TRANSITIONS.items()
    ]
    names = [f"    s{number}: {state}" for number, state in enumerate(states)]
    rows = ((f"`{state}`", f"`{event}`", f"`{to}`") for (state, event), to in krc_states.TRANSITIONS.items())
    explained = [
        _table((kind, "what it is"), ((f"`{each}`", text) for each, text in zip(of, texts, strict=True)))
        for kind, of, texts in (
            ("state", states, _texts_of_members(krc_states.KrcState)),
            ("event", events, _texts_of_members(krc_states.KrcEvent)),
        )
    ]
    settings = (
        (f"`{name}`", f"`{_type_name(field.annotation)}`", _bounds(field), _default(field), text)
        for (name, field), text in zip(
            KrcSettings.model_fields.items(), _texts_of_members(KrcSettings, fields=True), strict=True
        )
    )
    messages = ((f"`{code}`", text) for code, text in TEXTS.items())
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
            _table(("state", "event", "next state"), rows),
            "## Settings",
            "Of `python -m deltaq_emulator --settings FILE.yaml`; defaults are the maker's where they are known.",
            _table(("setting", "type", "bounds", "default", "meaning"), settings),
            "## Messages on the pendant",
            "Codes that begin with KSS are the maker's numbers; the wording is not.",
            _table(("code", "text"), messages),
        ]
    )


def _sessions() -> str:
    rows = (
        (f"`{row.belief}`", f"`{row.kind}`", f"`{row.answer}`", f"`{row.next_belief}`")
        for row in session.AUTOMATON
    )
    tables = [
        _table(
            (name, "meaning"),
            ((f"`{one}`", text) for one, text in zip(members, _texts_of_members(members), strict=True)),
        )
        for name, members in (
            ("belief", session.Belief),
            ("telegram", session.Kind),
            ("answer", session.Answer),
        )
    ]
    return "\n\n".join(
        [
            "# Sessions of a KRC",
            f"A session is believed after {session.CONFIRMATIONS} telegrams in a row that agree and stand still, and "
            f"come no faster than {1 / session.PACE:g} times their own pace."
            " [What else is believed of a telegram, and why](../explanation/the-last-metre.md).",
            _table(("belief", "telegram", "answer", "next belief"), rows),
            *tables,
        ]
    )


def _texts_of_members(members: type[Enum] | type[BaseModel], fields: bool = False) -> list[str]:
    """The text below each member of a table in its source; `fields` may lack one."""
    body = ast.parse(inspect.getsource(members)).body[0]
    assert isinstance(body, ast.ClassDef)  # that is what it was given
    texts: list[str] = []
    for node in body.body[1:]:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            texts[len(texts) - fields :] = [" ".join(str(node.value.value).split())]
        elif fields and isinstance(node, ast.AnnAssign):
            texts.append("")
    return texts


def _cell() -> str:
    head = (
        "# Fields of a cell\n\nA cell is a YAML file with the fields of `CellDescription`; `deltaq check` says what is"
        " wrong with one. Units are in the names of the fields."
    )
    return "\n\n".join(
        [head, *(_model(model, level=2) for model in _models(description, description.Description))]
    )


def _services() -> str:
    cell = load_cell("lab")
    rows = (
        (
            f"`{service.name}`",
            f"`python {' '.join(service.arguments)}`",
            ", ".join(f"`{name}`" for name in service.needs),
            ", ".join(f"{at.transport} {at.address}:{at.port}" for at in service.listens),
            service.probe,
        )
        for service in (*cell_services(cell, "lab"), *demo_controllers(cell), recorder("lab", "run.mcap"))
    )
    return (
        "# Services\n\nThe lab cell's, as `deltaq up` starts them; leader and follower belong to `deltaq demo`, the"
        " recorder to `deltaq up --record`. Each"
        " prints one line that begins with `ready:` once it serves.\n\n"
        + _table(("service", "command", "starts after", "listens on", "asked for health by"), rows)
    )


def _cli() -> str:
    command = typer.main.get_command(app)
    text = get_docs_for_click(
        obj=command, ctx=typer.Context(command), name="deltaq", title="The deltaq command"
    )
    exits = (
        "Exit status: 0 done, 1 the thing reported is bad, 2 wrong usage or configuration, 3 a service could not be"
        " reached.\n\n**Usage**"
    )
    return text.replace("**Usage**", exits, 1)


def _models(module: Any, base: type[BaseModel]) -> list[type[BaseModel]]:
    """The models that a module defines, in its order."""
    return [
        value
        for value in vars(module).values()
        if inspect.isclass(value)
        and issubclass(value, base)
        and value.__module__ == module.__name__
        and value is not base
    ]


def _model(model: type[BaseModel], level: int) -> str:
    rows = (
        (f"`{name}`", f"`{_type_name(field.annotation)}`", _bounds(field), _default(field))
        for name, field in model.model_fields.items()
    )
    text = inspect.cleandoc(model.__doc__ or "")
    return f"{'#' * level} {model.__name__}\n\n{text}\n\n" + _table(
        ("field", "type", "bounds", "default"), rows
    )


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    return f"`{type(default).__name__}()`" if isinstance(default, BaseModel) else f"`{default!r}`"


def _type_name(annotation: Any) -> str:
    """A type as people read it: without its bounds, and null for None."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if annotation is type(None):
        return "null"
    if origin is Annotated:
        return _type_name(arguments[0])
    if origin is Literal:
        return " or ".join(repr(value) for value in arguments)
    if origin in (Union, UnionType):
        return " or ".join(_type_name(argument) for argument in arguments)
    if arguments:
        inner = ", ".join("..." if argument is Ellipsis else _type_name(argument) for argument in arguments)
        return f"{annotation.__name__}[{inner}]"
    return str(annotation.__name__)


def _bounds(field: FieldInfo) -> str:
    bounds = []
    for item in [*field.metadata, *_metadata(field.annotation)]:
        for name, sign in _SIGNS.items():
            if (bound := getattr(item, name, None)) is not None:
                bounds.append(f"{sign} {bound}")
    return ", ".join(dict.fromkeys(bounds))


def _metadata(annotation: Any) -> list[Any]:
    """Bounds of the parts of an alternative, e.g. of a number that may be null."""
    found: list[Any] = []
    if get_origin(annotation) is Annotated:
        for item in annotation.__metadata__:
            found += item.metadata if isinstance(item, FieldInfo) else [item]
    elif get_origin(annotation) in (Union, UnionType):
        for argument in get_args(annotation):
            found += _metadata(argument)
    return found


def _message_link(message: type[BaseModel]) -> str:
    return f"[{message.__name__}](messages.md#{message.__name__.lower()})"


def _table(columns: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    columns = list(columns)
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join("| " + " | ".join(_cell_text(value) for value in line) + " |" for line in lines)


def _cell_text(value: object) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value).replace("|", "\\|").replace("\n", " ")


def main() -> None:
    """Write all pages."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
