"""Which tests run by day, and which only when the night is asked for."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).parents[1] / "conftest.py"

HOOKS = f"""
import importlib.util

spec = importlib.util.spec_from_file_location("what_every_run_shares", {str(SHARED)!r})
shared = importlib.util.module_from_spec(spec)
spec.loader.exec_module(shared)
pytest_itemcollected = shared.pytest_itemcollected
pytest_collection_modifyitems = shared.pytest_collection_modifyitems
"""

INI = """
[pytest]
asyncio_default_fixture_loop_scope = function
markers =
    nightly
    by_day
    long
    container
"""

TESTS = """
import pytest

@pytest.mark.by_day(2)
@pytest.mark.parametrize("one", range(5))
def test_many(one):
    pass

@pytest.mark.by_day(1)
@pytest.mark.parametrize("one", range(3))
class TestGroup:
    def test_first(self, one):
        pass

    def test_second(self, one):
        pass

@pytest.mark.nightly
def test_long():
    pass

@pytest.mark.by_day(1)
def test_alone():
    pass
"""

DAY = ["many[0]", "many[1]", "first[0]", "second[0]", "alone"]
NIGHT = ["many[2]", "many[3]", "many[4]", "first[1]", "first[2]", "second[1]", "second[2]", "long"]


@pytest.mark.parametrize(("asked", "run"), [((), DAY), (("-m", "nightly"), NIGHT)])
def test_of_many_parameters_the_first_run_by_day_and_the_others_only_if_asked(
    pytester: pytest.Pytester, asked: tuple[str, ...], run: list[str]
) -> None:
    pytester.makeconftest(HOOKS)
    pytester.makeini(INI)
    pytester.makepyfile(TESTS)
    result = pytester.inline_run(*asked)
    passed, skipped, failed = result.listoutcomes()
    names = [report.nodeid.rpartition("test_")[2] for report in passed]
    assert sorted(names) == sorted(run)
    assert not skipped + failed
