"""Ends what tests of several files share after the last test that asks for it, instead of with the session.

A cell that runs costs half a core also while nobody asks it anything. Files that share one are run one
after the other.
"""

from collections.abc import Generator
from contextlib import AbstractContextManager, ExitStack
from typing import TypeVar

import pytest

SHARED = ("shared_stack", "lone_console", "chromium")
"""Fixtures of the session that end after their last test; the order in which their files run."""

T = TypeVar("T")


class LastUse:
    """Context managers that are open, by the fixture that entered them."""

    def __init__(self) -> None:
        self.of: dict[str, pytest.Item] = {}
        self._open: dict[str, ExitStack] = {}

    def enter(self, fixture: str, context: AbstractContextManager[T]) -> T:
        """Enter a context manager, which is left after the last test that asks for the fixture."""
        self._open[fixture] = ExitStack()
        return self._open[fixture].enter_context(context)

    def leave(self, fixture: str) -> None:
        """Leave it, if it was entered."""
        if fixture in self._open:
            self._open.pop(fixture).close()

    def leave_after(self, item: pytest.Item) -> None:
        """Leave what this was the last test for."""
        for fixture in [fixture for fixture, last in self.of.items() if last is item]:
            self.leave(fixture)


_KEY = pytest.StashKey[LastUse]()


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_KEY] = LastUse()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put files together that share a fixture, and remember the last test of each."""
    asked = [(item, set(getattr(item, "fixturenames", ())) & {*SHARED}) for item in items]
    files = {item.path: max(map(SHARED.index, shared)) for item, shared in asked if shared}
    items.sort(key=lambda item: files.get(item.path, -1))
    uses = dict(zip(items, [set(getattr(item, "fixturenames", ())) for item in items], strict=True))
    config.stash[_KEY].of = {name: item for name in SHARED for item in items if name in uses[item]}


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, None, None]:
    yield
    item.config.stash[_KEY].leave_after(item)


@pytest.fixture(scope="session")
def last_use(pytestconfig: pytest.Config) -> Generator[LastUse, None, None]:
    """Where fixtures of the session enter what shall end before it."""
    kept = pytestconfig.stash[_KEY]
    yield kept
    for fixture in SHARED[::-1]:
        kept.leave(fixture)
