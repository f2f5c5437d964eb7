"""Check a cell description more deeply than its schema can: against its robots' models and against itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deltaq_cell.cell_model import CellModel
from deltaq_cell.check_description import DescriptionCheck
from deltaq_cell.check_models import ModelCheck
from deltaq_cell.description import CellDescription
from deltaq_cell.find import find_cell
from deltaq_cell.load import load_located
from deltaq_cell.models import RobotModelError
from deltaq_cell.never_checked import Pair, Why
from deltaq_cell.placed_problems import PlacedProblems
from deltaq_cell.problems import CellError, Problem
from deltaq_cell.robot import RobotModel


@dataclass(frozen=True)
class CheckReport:
    """The result of `check_cell`.

    Attributes:
        cell: the name or path that was checked.
        problems: errors and warnings, in the order of the file.
        never_checked: by robot, pairs of its bodies that are never checked, and why.
    """

    cell: str
    problems: tuple[Problem, ...]
    never_checked: dict[str, dict[Pair, Why]]

    @property
    def errors(self) -> tuple[Problem, ...]:
        """Problems that keep the cell from being used."""
        return tuple(problem for problem in self.problems if problem.severity == "error")

    @property
    def warnings(self) -> tuple[Problem, ...]:
        """Problems that do not keep the cell from being used."""
        return tuple(problem for problem in self.problems if problem.severity == "warning")

    @property
    def ok(self) -> bool:
        """True if there are no errors."""
        return not self.errors

    def as_dict(self) -> dict[str, Any]:
        """The report as a JSON object."""
        problems = [problem.as_dict() for problem in self.problems]
        left_out = {
            robot: [{"pair": list(pair), "why": why} for pair, why in pairs.items()]
            for robot, pairs in self.never_checked.items()
        }
        return {"cell": self.cell, "ok": self.ok, "problems": problems, "never_checked": left_out}


def check_cell(name_or_path: str | Path) -> CheckReport:
    """Check a cell; see `CheckReport`. No fault of the cell raises an exception."""
    try:
        path = find_cell(name_or_path)
        description, tree = load_located(path)
    except CellError as error:
        return CheckReport(str(name_or_path), error.problems, {})
    never_checked: dict[str, dict[Pair, Why]] = {}
    found = _problems(path, description, PlacedProblems(tree), never_checked)
    problems = sorted(found, key=lambda problem: (problem.file, problem.line))
    return CheckReport(str(name_or_path), tuple(problems), never_checked)


def _problems(
    path: Path, cell: CellDescription, placed: PlacedProblems, never_checked: dict[str, dict[Pair, Why]]
) -> Iterator[Problem]:
    """All problems; robots whose model is sound are put into `never_checked`."""
    described, modelled = DescriptionCheck(path, cell, placed), ModelCheck(cell, placed)
    yield from described.of_cell()
    models: dict[str, RobotModel] = {}
    for name, robot in cell.robots.items():
        yield from described.of_robot(name, robot)
        try:
            model = RobotModel(robot, name)
            never_checked[name] = model.never_checked  # the pairs that it names are looked for here
        except RobotModelError as error:
            place = ("robots", name, *(int(part) if part.isdigit() else part for part in error.field))
            yield placed.at(place, str(error), suggestion=error.suggestion)
            continue
        models[name] = model
        yield from modelled.of_robot(model)
    if len(models) == len(cell.robots):
        yield from modelled.of_cell(CellModel.of(cell, models))
