"""Finds what a scenario names: a controller or a function in a file beside it, or in a package."""

from __future__ import annotations

import importlib
import sys
import traceback
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

from deltaq_testing.scenario.file import ScenarioError


def resolved(reference: str, folder: Path) -> Any:
    """What a reference names.

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
    # what it imports from files beside it is found as if it had been run there
    sys.path.insert(0, str(file.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.parent))
    return module
