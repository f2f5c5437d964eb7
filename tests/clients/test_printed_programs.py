"""What the pages print for other languages runs, word for word but for the port, beside a running HLI."""

import os
from pathlib import Path

import octave
import pages
import pytest
from languages import LANGUAGES
from ran import ran

ROOT = Path(__file__).parents[2]
HERE = "tests/clients/test_printed_programs.py runs it"
NEEDS = {"g++": LANGUAGES[1], "node": LANGUAGES[2]}

pytestmark = [pytest.mark.live, pytest.mark.long]


def printed() -> list[tuple[str, pages.Step]]:
    return [
        (page.name, step)
        for page in (ROOT / "README.md", *sorted((ROOT / "docs" / "how-to").glob("*.md")))
        for step in pages.steps(page.read_text(encoding="utf-8"))
        if step.argument.startswith(HERE)
    ]


@pytest.fixture(scope="module")
def port(shared_stack):
    return shared_stack.renewed().cell.tcp_port


@pytest.mark.parametrize(("page", "step"), printed(), ids=lambda given: getattr(given, "line", given))
def test_a_printed_program_runs_in_a_clone(page: str, step: pages.Step, port: int, tmp_path: Path) -> None:
    text = step.text.replace("5210", str(port))
    assert text != step.text
    (tmp_path / "clients").symlink_to(ROOT / "clients")
    if step.language == "matlab":
        why_not, command = octave.why_no_octave(), [*octave.command("")[:-1], text]
    else:
        language = NEEDS[step.text.split()[0]]
        why_not, command = language.why_not(), ["bash", "-euc", text]
    if why_not:
        pytest.skip(why_not)
    done = ran(command, cwd=tmp_path, env={**os.environ, **octave.environment()}, check=False)
    assert done.returncode == 0, (page, step.line, done.stderr)
    assert done.stdout.strip()


def test_every_language_is_printed_somewhere() -> None:
    assert {step.text.split()[0] for _, step in printed()} >= set(NEEDS)
    assert {page for page, step in printed() if step.language == "matlab"} == {
        "README.md",
        "other-languages.md",
    }
