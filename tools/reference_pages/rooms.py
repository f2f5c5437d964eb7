"""The page of rooms: which package imports which, as the code has it."""

from __future__ import annotations

import ast
from importlib.util import find_spec
from pathlib import Path

from reference_pages.markdown import table

ROOMS = (
    ("experiments", "the papers' experiments, reports of recordings, benchmarks, the Gymnasium environment"),
    ("testing", "virtual cell, faults, impaired wires, replay, scenarios, a plug-in of pytest"),
    ("deploy", "cells, the launcher, the `deltaq` command, the files of a KRC; beside it the image"),
    ("services", "HLI, SIM (the gate), Robot Server, recorder, console: a folder a process"),
    ("emulator", "an emulated KRC that speaks RSI, and its faults"),
    ("controllers", "camera follower, teleoperation, advisor"),
    ("cell", "the model of a cell: description, robots, kinematics, proximity"),
    ("protocol", "what crosses a wire, and the client that a controller imports"),
)
"""Folder and what it is for, from the top; none imports one above it."""


def rooms() -> str:
    """The table of rooms and the picture of their imports."""
    lines = [f"    {of} --> {to}" for of, to in sorted(_arrows())]
    rows = ((f"`{name}/`", what) for name, what in ROOMS)
    return "\n\n".join(
        [
            "# Rooms",
            "Each folder is a source root and holds one package, `deltaq_` before its name. The command line,"
            " `deltaq_deploy.command`, stands above all rooms and is not drawn. import-linter refuses an"
            " import from a lower row to a higher one, between `services`, `emulator` and `controllers`, between the"
            " services, and of clocks, sockets or zenoh outside of the shells. [Where a change goes](../explanation/"
            "architecture.md).",
            table(("folder", "what lives here"), rows),
            "\n".join(["```mermaid", "graph TD", *lines, "```"]),
        ]
    )


def _arrows() -> set[tuple[str, str]]:
    """Each room with each other room that one of its modules imports."""
    return {(name, to) for name, _ in ROOMS for path in _files(name) for to in _imported(path) - {name}}


def _imported(path: Path) -> set[str]:
    """The rooms that a module imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            names = [node.module]
        found |= {
            name.partition(".")[0].removeprefix("deltaq_") for name in names if name.startswith("deltaq_")
        }
    return found


def _files(name: str) -> list[Path]:
    spec = find_spec(f"deltaq_{name}")
    assert spec is not None  # every room is in the wheel
    assert spec.origin is not None  # and a package
    folder = Path(spec.origin).parent
    return sorted(path for path in folder.rglob("*.py") if "command" not in path.relative_to(folder).parts)
