"""Inputs of a test do not depend on the tests that ran before it."""

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
GENERATORS = ("default_rng", "Generator", "Random", "RandomState")


def shared_generators(text: str) -> list[int]:
    """Lines at which a module keeps a generator of random numbers for all its tests."""
    kept = [node for node in ast.parse(text).body if isinstance(node, ast.Assign | ast.AnnAssign)]
    return [
        node.lineno
        for node in kept
        if isinstance(node.value, ast.Call) and ast.unparse(node.value.func).endswith(GENERATORS)
    ]


def test_a_generator_is_found_where_tests_would_share_it() -> None:
    shared = "a = np.random.default_rng(1)\nb: Random = random.Random(2)\n"
    assert shared_generators(shared) == [1, 2]
    assert (
        shared_generators("STARTS = np.random.default_rng(1).uniform(0, 1, 3)\ndef f():\n    a = Random(1)")
        == []
    )


@pytest.mark.long
@pytest.mark.parametrize("path", sorted(TESTS.rglob("*.py")), ids=lambda path: str(path.relative_to(TESTS)))
def test_no_module_of_tests_shares_a_generator_among_them(path: Path) -> None:
    assert shared_generators(path.read_text(encoding="utf-8")) == []
