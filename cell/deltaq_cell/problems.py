"""Problems of a cell description: file, line, field, value, bound, suggestion."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from deltaq_protocol.errors import DeltaqError, Severity


@dataclass(frozen=True)
class Problem:
    """One fault in a cell description.

    Attributes:
        file: name of the file it is in.
        line: line in that file, from 1; 0 where the file as a whole is meant.
        field: path of the field, e.g. `robots.fr.joints.a1.home_deg`; empty for the whole file.
        message: the fault, the allowed values, the remedy.
        value: the given value, if a single value is at fault.
        bound: the allowed value, if there is a bound.
        suggestion: the name that was probably meant.
        severity: an error keeps the cell from being used; a warning does not.
    """

    file: str
    line: int
    field: str
    message: str
    value: str | int | float | bool | None = None
    bound: str | int | float | None = None
    suggestion: str | None = None
    severity: Severity = "error"

    def __str__(self) -> str:
        """`lab.yaml:6: robots.fr.basee: not a field here; did you mean 'base'?`."""
        where = f"{self.file}:{self.line}" if self.line else self.file
        return ": ".join(part for part in (where, self.field, self.message) if part)

    def as_dict(self) -> dict[str, Any]:
        """All attributes, as a JSON object."""
        return asdict(self)


class CellError(DeltaqError):
    """A cell description that cannot be used; `problems` holds every error that was found in it."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        super().__init__("\n".join(str(problem) for problem in problems))
        self.problems = tuple(problems)
