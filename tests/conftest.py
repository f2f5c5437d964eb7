"""What every run of the tests shares: the examples that are drawn, what is left out, and the order."""

import os
import signal
import tempfile
from collections import Counter
from contextlib import ExitStack

import pytest
from hypothesis import HealthCheck, settings

pytest_plugins = ["installed", "last_use", "pytester", "shared_cell"]

# a change is judged by the same examples wherever it is tested; `make nightly` looks further with new ones
# and however long the machine takes for it
untimed = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("repeatable", derandomize=True, max_examples=50, **untimed)
settings.register_profile("exploring", max_examples=2000, **untimed)
settings.load_profile("repeatable")


@pytest.fixture(scope="session", autouse=True)
def runtime_folder():
    """A folder for the sockets of the guarded realm; its path is short, as that of a Unix socket has to be."""
    from deltaq_services.hli.zenoh_session import let_threads_wait

    let_threads_wait()  # as the HLI's process does, before a test opens the first session
    before = os.environ.get("XDG_RUNTIME_DIR")
    with tempfile.TemporaryDirectory(prefix="dq-", dir="/tmp") as folder:
        os.environ["XDG_RUNTIME_DIR"] = folder
        yield folder
    if before is None:
        del os.environ["XDG_RUNTIME_DIR"]
    else:
        os.environ["XDG_RUNTIME_DIR"] = before


@pytest.fixture(scope="session", autouse=True)
def state_home(tmp_path_factory):
    """A folder for what `deltaq up` keeps, so that tests leave nothing among the user's own."""
    before = os.environ.get("XDG_STATE_HOME")
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))
    yield
    if before is None:
        del os.environ["XDG_STATE_HOME"]
    else:
        os.environ["XDG_STATE_HOME"] = before


@pytest.fixture
def opened():
    """Opens zenoh sessions, as `open_session` does, and closes them all at the end of the test."""
    from deltaq_protocol.session import open_session

    with ExitStack() as sessions:
        yield lambda **options: sessions.enter_context(open_session(**options))


ONLY_IF_ASKED = ("nightly", "container")
"""Tests under these markers run only where `-m` names the marker; whatever else `-m` says adds to that."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # whoever starts the tests in the background ignores Ctrl-C for them, and for the processes that must obey it here
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_ignore_collect(collection_path, config):
    """Where only tests of one kind are asked for that few files have, do not import the many others."""
    kind = config.option.markexpr
    if kind not in ("live", "service") or collection_path.suffix != ".py":
        return None
    return True if f"mark.{kind}" not in collection_path.read_text(encoding="utf-8") else None


@pytest.hookimpl(tryfirst=True)
def pytest_itemcollected(item):
    """Leave what is no longer for the day to the night."""
    if (by_day := item.get_closest_marker("by_day")) is None:
        return
    function = item.nodeid.partition("[")[0]
    collected = item.session.stash.setdefault(_COLLECTED, Counter())
    collected[function] += 1
    if collected[function] > by_day.args[0]:
        item.add_marker("nightly")


_COLLECTED = pytest.StashKey()
"""How many parameters of each function were collected."""


def pytest_collection_modifyitems(config, items):
    """Leave out what runs only if asked, and begin with the files that take long."""
    asked = config.option.markexpr
    left_out = [name for name in ONLY_IF_ASKED if name not in asked]
    kept, deselected = [], []
    for item in items:
        (deselected if any(map(item.get_closest_marker, left_out)) else kept).append(item)
    # files with most long tests go first, so that no worker is left alone with one at the end
    long = Counter(item.path for item in kept if item.get_closest_marker("long") is not None)
    kept.sort(key=lambda item: -long[item.path])
    if deselected:
        config.hook.pytest_deselected(items=deselected)
    items[:] = kept
