"""Tells how far compiling ahead is."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

TELLS_EACH = "DELTAQ_TELLS_EACH_FUNCTION"
"""Environment variable, set for a compiler by a program that counts for itself."""
_TOLD_EVERY = 20
"""Functions; where there is a terminal, one line counts them all."""


@contextmanager
def compiling_shown(what: str, about: int) -> Iterator[None]:
    """Print how far it is with what is compiled within the block; nothing where nothing is.

    Args:
        what: is compiled.
        about: how many functions that is, to estimate from.
    """
    from deltaq_cell.compiled import told_of_compiling  # loads numba

    count, end = 0, "\r" if sys.stdout.isatty() else "\n"

    def show(function: str) -> None:
        nonlocal count
        if TELLS_EACH in os.environ:
            print(f"compiling {function}", flush=True)
            return
        if end == "\r" or count % _TOLD_EVERY == 0:
            print(
                f"compiling {what}: {count} of about {max(about, count + 1)} functions", end=end, flush=True
            )
        count += 1

    with told_of_compiling(show):
        yield
    if count:
        print(f"compiled {what}: {count} functions" + (30 * " " if end == "\r" else ""), flush=True)
