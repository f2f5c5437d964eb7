"""Runs scenarios, and checks their expectations."""

import importlib
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.observed import RunFinding
from deltaq_testing.scenario.model import Scenario, ScenarioError, Tracking
from deltaq_testing.virtual import CellUnderTest
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

# Finds a scenario's controllers and functions, in files beside it or in packages.


def resolved(reference: str, folder: Path) -> Any:
    """The object that a reference names.

    Args:
        reference: `file.py:name` or `package.module:name`.
        folder: that the file is relative to.

    Raises:
        ScenarioError: there is no such file, module or name, or it cannot be imported.
    """
    module, _, name = reference.rpartition(":")
    try:
        found = _of_file(folder / module) if module.endswith(".py") else importlib.import_module(module)
    except FileNotFoundError:
        raise ScenarioError(f"{reference}: there is no file {folder / module}") from None
    except Exception as error:
        raise ScenarioError(f"{reference} cannot be imported: {where(error)}") from None
    if not hasattr(found, name):
        raise ScenarioError(f"{reference}: {module} has nothing that is called {name!r}")
    return getattr(found, name)


def where(error: BaseException) -> str:
    """An error in a line, with the line of code that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    text = f"{type(error).__name__}: {error}".splitlines()[0]
    return f"{text} ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else text


def _of_file(file: Path) -> ModuleType:
    if not file.is_file():
        raise FileNotFoundError(file)
    spec = spec_from_file_location(file.stem, file)
    assert spec is not None  # it ends in .py
    assert spec.loader is not None
    module = module_from_spec(spec)
    # imports from files beside it work as if it had been run there
    sys.path.insert(0, str(file.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.parent))
    return module


ENDED = "the run came to its end"


@dataclass(frozen=True)
class Check:
    """An expectation, and whether it was met."""

    what: str
    finding: RunFinding


@dataclass(frozen=True)
class ScenarioOutcome:
    """The result of a scenario.

    Attributes:
        name: of the scenario.
        scenario: the scenario that was run.
        checks: results of the expectations, in their order.
        cell: with all records.
        wall_s: how long the run took.
    """

    name: str
    scenario: Scenario
    checks: tuple[Check, ...]
    cell: CellUnderTest
    wall_s: float

    @property
    def good(self) -> bool:
        """Whether every expectation was met."""
        return all(check.finding for check in self.checks)


@dataclass
class Runner:
    """Runs scenarios; a cell that several of them name is read once.

    Args:
        folder: that files of scenarios are relative to.
    """

    folder: Path
    _loaded: dict[str, LoadedCell] = field(default_factory=dict)

    def run(self, scenario: Scenario, name: str) -> ScenarioOutcome:
        """Run a scenario; an error of the controller is an expectation that was not met.

        Raises:
            ScenarioError: it names a missing file or object.
            UnknownFaultError: its cell has no such robot, or robots without a KRC.
            CellError: there is no such cell.
        """
        began_s = time.perf_counter()
        cell = CellUnderTest(self._cell(scenario.cell), scenario.robot, scenario.seed)
        try:
            self._drive(cell, scenario)
            error = _run(cell, scenario)
        finally:
            cell.close()
        ended = RunFinding(error is None, error or f"{cell.time_s:g} s")
        checks = (Check(ENDED, ended), *self._checks(cell, scenario))
        return ScenarioOutcome(name, scenario, checks, cell, time.perf_counter() - began_s)

    def _cell(self, name: str) -> LoadedCell:
        beside = self.folder / name
        if name not in self._loaded:
            self._loaded[name] = load_rsi_cell(beside if beside.is_file() else name)
        return self._loaded[name]

    def _drive(self, cell: CellUnderTest, scenario: Scenario) -> None:
        if scenario.controller is not None:
            cell.drive(resolved(scenario.controller, self.folder))
        if scenario.command is not None:
            cell.drive_process(scenario.command, folder=self.folder)
        for robot, controller in scenario.others.items():
            cell.drive(resolved(controller, self.folder), robot)
        cell.suffer(*(entry.timed for entry in scenario.faults))

    def _checks(self, cell: CellUnderTest, scenario: Scenario) -> Iterator[Check]:
        expect = scenario.expect
        if expect.kept_clear:
            yield Check("kept clear", cell.kept_clear())
        if expect.kept_limits:
            yield Check("kept limits", cell.kept_limits())
        if expect.rested_within_cycles is not None and cell.fault_rows:
            yield Check("rested", cell.rested_within(expect.rested_within_cycles))
        if expect.reasons is not None:
            held = ", ".join(cell.reasons) or "never"
            wanted = ", ".join(expect.reasons) or "never"
            yield Check(
                "held for", RunFinding(list(cell.reasons) == expect.reasons, f"{held}; expected: {wanted}")
            )
        if expect.phase is not None:
            yield Check(
                "phase", RunFinding(cell.phase == expect.phase, f"{cell.phase}; expected: {expect.phase}")
            )
        if expect.ends_at is not None:
            goal = expect.ends_at.q or [
                one + home for one, home in self._from_home(cell, expect.ends_at.from_home)
            ]
            yield Check("ends at", cell.ended_at(goal, expect.ends_at.within))
        if expect.tracking is not None:
            yield from self._tracking(cell, expect.tracking)

    def _tracking(self, cell: CellUnderTest, tracking: Tracking) -> Iterator[Check]:
        reference = resolved(tracking.reference, self.folder)
        try:
            error = cell.tracking_error(reference)
        except DeltaqError:
            raise
        except Exception as raised:
            yield Check("tracking", RunFinding(False, f"the reference raised {where(raised)}"))
            return
        for name in ("max", "rms", "final"):
            bound, value = getattr(tracking, name), getattr(error, name)
            if bound is not None:
                told = f"{value:.4f} off; at most {bound:g} were allowed"
                yield Check(f"tracking, {name}", RunFinding(value <= bound, told))

    def _from_home(self, cell: CellUnderTest, moved: list[float] | None) -> Iterator[tuple[float, float]]:
        if moved is None or len(moved) != len(cell.home):
            given = 0 if moved is None else len(moved)
            raise ScenarioError(f"expect.ends_at.from_home: must have {len(cell.home)} joints, got {given}")
        return zip(moved, cell.home.tolist(), strict=True)


def _run(cell: CellUnderTest, scenario: Scenario) -> str | None:
    """Run it to its end; returns the controller's error, if any."""
    try:
        if scenario.recover_at_s is not None:
            cell.run(scenario.recover_at_s)
            cell.recover()
        cell.run(scenario.duration_s - cell.time_s)
    except DeltaqError as error:
        return str(error)
    except Exception as error:
        return f"the controller raised {where(error)}"
    return None
