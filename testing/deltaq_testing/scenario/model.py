"""Scenario files: their fields, reading them with errors that name line and bound, and writing them."""

import json
import os
from pathlib import Path
from typing import Annotated, Any, Self

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from deltaq_cell.load import problem_of
from deltaq_cell.problems import Problem
from deltaq_cell.yaml_tree import MAX_BYTES, parse
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.schedule import FOR_S, TimedFault, checked, fault

MAX_S = 3600.0
"""Longest run, in the cell's time [s]."""

Time = Annotated[float, Field(ge=0, le=MAX_S)]
Duration = Annotated[float, Field(gt=0, le=MAX_S)]
ErrorBound = Annotated[float, Field(gt=0)]
JointVector = Annotated[list[float], Field(min_length=1, max_length=32)]
Reference = Annotated[str, Field(pattern=r"^[^:]+:[A-Za-z_]\w*$")]
"""`file.py:name`, the file beside the scenario's, or `package.module:name`."""


class ScenarioModel(BaseModel):
    """Base of the parts of a scenario."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class FaultEntry(ScenarioModel):
    """A fault of the catalogue, from `at_s` on and for `for_s` [s]; 0 is when the controllers are connected."""

    fault: str
    at_s: Time
    for_s: Duration = FOR_S

    @field_validator("fault")
    @classmethod
    def _is_in_the_catalogue(cls, name: str) -> str:
        try:
            fault(name, at_s=0.0)
        except DeltaqError as error:
            raise ValueError(str(error)) from None
        return name

    @property
    def timed(self) -> TimedFault:
        """The entry as a fault of a cell."""
        return fault(self.fault, at_s=self.at_s, for_s=self.for_s)


class EndsAt(ScenarioModel):
    """Expected final configuration of the robot under test: `q`, or home plus `from_home` [rad or m].

    No joint may be further off than `within` [rad or m].
    """

    q: JointVector | None = None
    from_home: JointVector | None = None
    within: ErrorBound

    @model_validator(mode="after")
    def _says_where(self) -> Self:
        if (self.q is None) == (self.from_home is None):
            raise ValueError("give one of q and from_home, and not both")
        return self


class Tracking(ScenarioModel):
    """How far the robot may be from `reference`, a function from the time [s] to its n joints [rad or m].

    `max`, `rms` and `final` bound the error of the joint that is furthest off [rad or m].
    """

    reference: Reference
    max: ErrorBound | None = None
    rms: ErrorBound | None = None
    final: ErrorBound | None = None

    @model_validator(mode="after")
    def _bounds_something(self) -> Self:
        if self.max is None and self.rms is None and self.final is None:
            raise ValueError("give a bound: max, rms or final")
        return self


class Expectations(ScenarioModel):
    """Expected results; omitted ones are not checked, except `kept_clear` and `kept_limits`.

    `kept_clear` and `kept_limits` are asked unless they say false. `rested_within_cycles` counts from the first fault.
    `reasons` are those for which the robot was held, in order: none for an empty list. `phase` is that in the end.
    """

    kept_clear: bool = True
    kept_limits: bool = True
    rested_within_cycles: Annotated[int, Field(ge=0, le=100_000)] | None = None
    reasons: list[ReasonCode] | None = None
    phase: Phase | None = None
    ends_at: EndsAt | None = None
    tracking: Tracking | None = None


class FaultSearch(ScenarioModel):
    """The draw of `deltaq fault search` in place of `faults`.

    It has at most `most` faults, of at most `longest_s` [s] each. `faults` names the candidates; by default all that
    are possible in virtual time.
    """

    faults: Annotated[list[str], Field(min_length=1)] | None = None
    most: Annotated[int, Field(ge=1, le=20)] = 3
    longest_s: Duration = 1.0

    @field_validator("faults")
    @classmethod
    def _are_in_the_catalogue(cls, names: list[str] | None) -> list[str] | None:
        for name in names or ():
            FaultEntry(fault=name, at_s=0.0)
        return names


class Scenario(ScenarioModel):
    """A run of a cell in virtual time.

    `controller` drives the robot under test: `file.py:name` or `package.module:name` of what `CellUnderTest.drive`
    takes. `command` is a program instead, `{port}` in it the port to connect to; it is started in the file's folder.
    `others` names controllers of further robots. At `recover_at_s` an operator recovers the robot.
    """

    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    cell: str = "lab"
    robot: str | None = None
    duration_s: Duration
    controller: Reference | None = None
    command: Annotated[list[str], Field(min_length=1)] | None = None
    others: dict[str, Reference] = {}
    faults: Annotated[list[FaultEntry], Field(max_length=100)] = []
    recover_at_s: Time | None = None
    expect: Expectations = Expectations()
    search: FaultSearch = FaultSearch()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.controller is None) == (self.command is None):
            raise ValueError("give one of controller and command, and not both")
        times = [(f"{entry.fault}: at_s", entry.at_s) for entry in self.faults]
        if self.recover_at_s is not None:
            times.append(("recover_at_s", self.recover_at_s))
        for name, at_s in times:
            if at_s >= self.duration_s:
                raise ValueError(f"{name} must be less than duration_s, {self.duration_s:g}, got {at_s:g}")
        if self.expect.rested_within_cycles is not None and not self.faults:
            raise ValueError("expect.rested_within_cycles counts from the first fault, and there is none")
        try:
            checked([entry.timed for entry in self.faults])
        except DeltaqError as error:
            raise ValueError(str(error)) from None
        return self


# Reads scenario files, with errors that name file, line, field, value and bound; and writes them.


class ScenarioError(DeltaqError):
    """A scenario that cannot be run, with all that is wrong with its file."""


def load_scenario(file: Path) -> Scenario:
    """Read a scenario.

    Raises:
        ScenarioError: it cannot be read, or has errors; each is a line.
        CellError: it is no YAML.
    """
    try:
        with file.open("rb") as stream:
            text = stream.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise ScenarioError(f"{file}: must be {MAX_BYTES} bytes or less")
        return parse_scenario(text.decode("utf-8-sig"), file.name)
    except OSError as error:
        raise ScenarioError(f"{file}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{file}: is not UTF-8 text; save it as UTF-8") from None


def parse_scenario(text: str, source: str) -> Scenario:
    """The scenario in a YAML text; `source` names it in messages. Raises as `load_scenario` does."""
    tree = parse(text, source)
    if not isinstance(tree.value, dict):
        raise ScenarioError(f"{source}: must be a mapping with the fields controller and duration_s")
    try:
        # as JSON, because strict validation takes JSON's lists for tuples but no text for numbers
        return Scenario.model_validate_json(json.dumps(tree.plain()), strict=True)
    except ValidationError as error:
        problems: list[Problem] = [problem_of(tree, dict(item), Scenario) for item in error.errors()]
        raise ScenarioError("\n".join(map(str, problems))) from None


def dumped(scenario: Scenario) -> str:
    """A scenario as a YAML text, without default values."""
    fields: dict[str, Any] = scenario.model_dump(mode="json", exclude_defaults=True)
    return yaml.safe_dump(fields, sort_keys=False, allow_unicode=True)


def must_be_folder(folder: Path) -> None:
    """Make a folder for reports, before a long run is begun for them.

    Raises:
        ScenarioError: it cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"{folder}: is no folder for reports: {error.strerror}") from None


def write_report(file: Path, text: str) -> None:
    """Write a report in place of an older one; never half of it.

    Raises:
        ScenarioError: it cannot be written.
    """
    part = file.with_name(f".{file.name}.{os.getpid()}")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(file)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ScenarioError(f"{file}: cannot be written: {error.strerror}") from None
