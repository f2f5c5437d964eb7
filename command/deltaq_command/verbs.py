"""The group of verbs: an option that is refused is told with the value that was given, beside its name and bound."""

from __future__ import annotations

from typing import Any

import typer
from pydantic import ValidationError
from typer.core import TyperGroup


class Verbs(TyperGroup):
    """typer's group, whose own words name option and bound alone."""

    def invoke(self, ctx: Any) -> Any:  # typer keeps the class of its contexts to itself
        """Run a verb.

        Raises:
            typer.BadParameter: an option is not what it may be.
        """
        try:
            return super().invoke(ctx)
        except typer.BadParameter as error:
            if isinstance(error.__cause__, ValidationError):
                first, *_ = error.__cause__.errors()
                error.message = f"{error.message}, got {first['input']!r}"
            raise
