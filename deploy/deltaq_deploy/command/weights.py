"""Criteria and their weights as they are given on the command line."""

from __future__ import annotations

from collections.abc import Sequence

import typer


def weights_of(texts: Sequence[str] | None, option: str) -> dict[str, float] | None:
    """Criterion to weight, from texts such as `travel=1`; None for none."""
    return dict(_weight(text, option) for text in texts or ()) or None


def two_criteria(text: str) -> tuple[str, str] | None:
    """Names of two criteria to trade off, from a text such as `travel,compliance`; None for none."""
    if not text:
        return None
    first, _, second = text.partition(",")
    if not first or not second or "," in second or first == second:
        raise typer.BadParameter(f"--trade-off takes the names of two criteria, A,B, got {text!r}")
    return first, second


def _weight(text: str, option: str) -> tuple[str, float]:
    name, _, number = text.partition("=")
    try:
        return name, float(number)
    except ValueError:
        raise typer.BadParameter(f"{option} takes NAME=NUMBER, got {text!r}") from None
