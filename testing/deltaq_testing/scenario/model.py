"""The fields of a scenario file."""

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

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
