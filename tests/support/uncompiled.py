"""Compiled modules as the Python that they are written in.

To compile one of their parts by itself, as nobody but a test calls it, takes seconds, in the kernel a minute. That
the machine code of the whole says what its Python does, `tests/cell/test_kernel.py` holds of the kernel, and
`tests/controllers/test_compiled.py` of the camera's laws.
"""

import sys
from functools import cache
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pkgutil import iter_modules
from types import ModuleType

import numba

import deltaq_cell
import deltaq_cell.kernel

_KERNEL = "deltaq_cell.kernel"


@cache
def _modules() -> dict[str, ModuleType]:
    for module in iter_modules(deltaq_cell.kernel.__path__, f"{_KERNEL}."):
        import_module(module.name)
    compiled = _taken_away()
    is_disabled = numba.config.DISABLE_JIT
    numba.config.DISABLE_JIT = 1
    try:
        for name in compiled:
            import_module(name)
        return _taken_away()
    finally:
        numba.config.DISABLE_JIT = is_disabled
        sys.modules.update(compiled)
        deltaq_cell.kernel = compiled[_KERNEL]


def _taken_away() -> dict[str, ModuleType]:
    names = [name for name in sys.modules if name == _KERNEL or name.startswith(f"{_KERNEL}.")]
    return {name: sys.modules.pop(name) for name in names}


def uncompiled(name: str) -> ModuleType:
    """A module of the kernel, and all of the kernel that it calls, as Python; such as `gap`."""
    return _modules()[f"{_KERNEL}.{name}"]


def as_python(name: str) -> ModuleType:
    """A copy of a module, such as `deltaq_controllers.redundancy`, whose own functions are not compiled."""
    module = import_module(name)
    assert module.__file__ is not None
    spec = spec_from_file_location(f"{name}_as_python", module.__file__)
    assert spec is not None
    assert spec.loader is not None
    copy = module_from_spec(spec)
    is_disabled = numba.config.DISABLE_JIT
    numba.config.DISABLE_JIT = 1
    try:
        spec.loader.exec_module(copy)
    finally:
        numba.config.DISABLE_JIT = is_disabled
    return copy
