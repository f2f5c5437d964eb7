"""What is written of surviving mutants speaks of the code as it is."""

import ast
import textwrap
import tomllib

import pytest
from judge_mutants import PACKAGES, ROOT, Mutant, explained

EXPLAINED = sorted(explained())
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mutmut"]


def source_of(mutant: Mutant) -> str:
    """The text of the function that a mutant changes."""
    package = mutant.file.partition("/")[0]
    text = (PACKAGES[package] / mutant.file).read_text(encoding="utf-8")
    scope: ast.AST = ast.parse(text)
    for name in mutant.function.split("."):
        scope = next(node for node in ast.iter_child_nodes(scope) if getattr(node, "name", None) == name)
    return ast.get_source_segment(text, scope) or ""


def test_explanations_exist() -> None:
    assert len(EXPLAINED) > 10


@pytest.mark.parametrize(
    "mutant", EXPLAINED, ids=lambda mutant: f"{mutant.function}-{mutant.change[-1]}"[:80]
)
def test_the_mutated_line_of_each_explanation_exists(mutant: Mutant) -> None:
    lines = {line.strip() for line in textwrap.dedent(source_of(mutant)).splitlines()}
    taken_out = [line[1:] for line in mutant.change if line.startswith("-")]
    assert taken_out
    assert set(taken_out) <= lines


def test_explained_mutants_belong_to_mutated_files() -> None:
    """Or nobody would ever compare the explanation with what survives."""
    assert {mutant.file for mutant in EXPLAINED} <= set(SETTINGS["only_mutate"])


def test_mutated_files_and_judging_tests_exist_and_are_listed_once() -> None:
    mutated, judges = SETTINGS["only_mutate"], SETTINGS["pytest_add_cli_args_test_selection"]
    paths = [
        *(PACKAGES[file.partition("/")[0]] / file for file in mutated),
        *(ROOT / test for test in judges),
    ]
    assert [path for path in paths if not path.is_file()] == []
    assert len(set(paths)) == len(paths)
