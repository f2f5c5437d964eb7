"""The plug-in of pytest: fixtures of cells for the tested controller; a failure lists the faults of the run.

pytest loads it in every run where deltaq is installed, so nothing heavy is imported before a fixture asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from deltaq_testing.live import LiveCell, LiveCells
    from deltaq_testing.virtual import CellUnderTest
    from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

MARKER = "deltaq(cell='lab', robot=None, seed=0): cell, robot under test and seed of the fixture virtual_cell"
_SECTION = "faults in this run"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options for cell and seed of tests without a marker."""
    group = parser.getgroup("deltaq", "faults for robot controllers")
    group.addoption(
        "--deltaq-cell", default="lab", help="cell of tests that name none: a name or a file (lab)"
    )
    group.addoption("--deltaq-seed", type=int, default=0, help="seed of tests that give none (0)")


def pytest_configure(config: pytest.Config) -> None:
    """Make the marker known."""
    config.addinivalue_line("markers", MARKER)


@pytest.fixture(scope="session")
def new_virtual_cell(pytestconfig: pytest.Config) -> Callable[..., CellUnderTest]:
    """Makes cells in virtual time: `new_virtual_cell(cell="lab", robot=None, seed=0)`, as `CellUnderTest` takes them.

    For tests that need several, as those of hypothesis do, which run a test many times. A cell's model is read once.
    """
    from deltaq_testing.faults.panel import load_rsi_cell
    from deltaq_testing.virtual import CellUnderTest

    loaded: dict[str, LoadedCell] = {}

    def new(cell: str | None = None, robot: str | None = None, seed: int | None = None) -> CellUnderTest:
        name = str(cell or pytestconfig.getoption("--deltaq-cell"))
        if name not in loaded:
            loaded[name] = load_rsi_cell(name)
        return CellUnderTest(
            loaded[name], robot, pytestconfig.getoption("--deltaq-seed") if seed is None else seed
        )

    return new


@pytest.fixture
def virtual_cell(
    request: pytest.FixtureRequest, new_virtual_cell: Callable[..., CellUnderTest]
) -> Iterator[CellUnderTest]:
    """A fresh cell in virtual time, its robots ready and at home; the marker `deltaq` says which."""
    from deltaq_protocol.errors import DeltaqError

    marker = request.node.get_closest_marker("deltaq")
    try:
        cell = new_virtual_cell(*marker.args, **marker.kwargs) if marker is not None else new_virtual_cell()
    except (DeltaqError, TypeError) as error:
        pytest.fail(f"no cell could be made: {error}", pytrace=False)
    yield cell
    cell.close()


@pytest.fixture(scope="session")
def live_cells(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveCells]:
    """Keeps the cell of `live_cell` between tests, and ends it with the session."""
    from deltaq_testing.live import LiveCells

    with LiveCells(lambda: tmp_path_factory.mktemp("cell")) as cells:
        yield cells


@pytest.fixture
def live_cell(
    request: pytest.FixtureRequest, pytestconfig: pytest.Config, live_cells: LiveCells
) -> Iterator[LiveCell]:
    """A cell of real processes on free ports, its robots ready and the one under test at home.

    It is started once and made ready again between tests; the marker `deltaq` says which cell and robot. Its controller
    connects by itself, to `url` or `tcp_port`, or is started by `drive_process`. Time is real.
    """
    from deltaq_protocol.errors import DeltaqError

    marker = request.node.get_closest_marker("deltaq")
    asked = {} if marker is None else marker.kwargs
    try:
        cell = live_cells.get(
            str(asked.get("cell") or pytestconfig.getoption("--deltaq-cell")), asked.get("robot")
        )
    except DeltaqError as error:
        pytest.fail(f"no cell could be started: {error}", pytrace=False)
    yield cell
    cell.end_programs()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the faults of the run and its seed to a failure."""
    report = yield
    cell = getattr(item, "funcargs", {}).get("virtual_cell")
    if call.when == "call" and report.failed and cell is not None:
        report.sections.append((_SECTION, cell.account()))
    return report
