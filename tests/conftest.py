"""Tests that start real processes share a machine whose load they cannot choose."""

import signal
from pathlib import Path

import pytest
from hypothesis import settings

# a change is judged by the same examples wherever it is tested; `make nightly` looks further with new ones
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("exploring", deadline=None, max_examples=2000)
settings.load_profile("repeatable")

PROCESSES = ("tests/deploy", "tests/live")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # whoever starts the tests in the background ignores Ctrl-C for them, and for the processes that must obey it here
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Try a test of live processes again before it counts as failed; what is pure gets one try."""
    for item in items:
        folder = str(Path(str(item.path)).parent)
        if item.get_closest_marker("live") is not None or folder.endswith(PROCESSES):
            item.add_marker(pytest.mark.flaky(reruns=2))
