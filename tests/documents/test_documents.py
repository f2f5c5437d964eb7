import re
import shlex
import sys
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import pytest
import typer
from packaging.specifiers import SpecifierSet
from ran import ran
from typer.testing import CliRunner

from deltaq_deploy.command.app import RENAMED, app
from reference_pages import FOLDER, PAGES, page

ROOT = Path(__file__).parents[2]
DOCUMENTS = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
COMMAND: Any = typer.main.get_command(app)


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(PAGES))
def test_each_reference_page_agrees_with_the_code(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == page(name), "write it anew with `make docs`"


def test_every_reference_page_is_generated() -> None:
    written = {name for name in PAGES if name.startswith("reference/")}
    assert {f"reference/{file.name}" for file in (FOLDER / "reference").iterdir()} == written


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_every_link_to_a_file_has_a_target(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    links = re.findall(r"\]\((?!https?:)([^)#]+)(?:#[^)]*)?\)", text)
    dead = [link for link in links if not (document.parent / link).exists()]
    assert dead == []


@pytest.mark.parametrize("document", [ROOT / "CONTRIBUTING.md", ROOT / "docs/notes/architecture.md"])
def test_every_file_in_a_map_of_the_tree_exists(document: Path) -> None:
    named = set(re.findall(r"`([\w./]+(?:/|\.py))`", document.read_text(encoding="utf-8")))
    tree = [
        path
        for folder in ROOT.glob("[!.]*/")
        for path in folder.rglob("*")
        if "__pycache__" not in path.parts
    ]
    there = {
        "/" + str(path.relative_to(ROOT)) + "/" * path.is_dir() for path in (*ROOT.glob("[!.]*/"), *tree)
    }
    assert named
    assert [name for name in sorted(named) if not any(path.endswith("/" + name) for path in there)] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_every_deltaq_command_in_the_documents_parses(document: Path) -> None:
    text = document.read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    for line in "\n".join(blocks).splitlines():
        words = shlex.split(line.removesuffix(" &").partition(" || ")[0], comments=True)
        if not words or words[0] != "deltaq":
            continue
        understand(words)


def understand(words: list[str]) -> None:
    """Parse a command as it is typed, with the options of its group and its own, and run nothing."""
    command, (name, *rest) = COMMAND, words
    while True:
        context = command.make_context(name, rest)
        rest = [*getattr(context, "_protected_args", ()), *context.args]
        context.close()
        if not rest or not hasattr(command, "commands"):
            return
        name, command, rest = command.resolve_command(context, rest)


def every_help(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Every verb and group of verbs by its name."""
    yield name, command
    for own_name, child in getattr(command, "commands", {}).items():
        yield from every_help(child, f"{name} {own_name}")


@pytest.mark.parametrize(
    ("name", "command"), [*every_help(COMMAND, "deltaq")], ids=lambda one: one if isinstance(one, str) else ""
)
def test_each_help_text_ends_with_two_valid_commands(name: str, command: Any) -> None:
    head, *examples = command.epilog.split("\n\n")
    assert (head, len(examples)) == ("Examples:", 2)
    for example in examples:
        typed = example.removeprefix("[bold]").removesuffix("[/bold]")
        assert hasattr(command, "commands") or typed.startswith(name)
        understand(shlex.split(typed))


def test_there_are_at_most_27_verbs_and_former_verbs_name_the_present_ones() -> None:
    assert len(COMMAND.commands) <= 27
    for former, present in RENAMED.items():
        typed = CliRunner().invoke(app, [*former.split(), "--json"])
        assert (typed.exit_code, typed.stderr) == (
            2,
            f"deltaq: `deltaq {former}` is now `deltaq {present}`\n",
        )
        assert present.split()[0] in COMMAND.commands


@pytest.mark.long
def test_the_citation_file_follows_its_format() -> None:
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.citation-file-format"]
    checked = ran([*command, str(ROOT / "CITATION.cff")], check=False)
    assert checked.returncode == 0, checked.stdout


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="a newer Python has packages of its own")
def test_every_pinned_version_supports_the_oldest_promised_python() -> None:
    pins = set((ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines())
    asked = {f"{one.name}=={one.version}": one.metadata["Requires-Python"] or "" for one in distributions()}
    assert len(pins & asked.keys()) > 150
    assert [pin for pin in pins & asked.keys() if not SpecifierSet(asked[pin]).contains("3.11.0")] == []


def test_the_constraints_pin_versions_and_name_no_address() -> None:
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.+!]*", line), line
