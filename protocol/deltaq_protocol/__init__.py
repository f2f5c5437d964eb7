"""What crosses a link in deltaq, and the client that a controller imports.

Importing this package loads no other module: neither pinocchio nor coal, and zenoh, pydantic and numpy with `connect`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deltaq_protocol.client import connect

    __version__: str

__all__ = ["__version__", "connect"]


def __getattr__(name: str) -> Any:
    """Load `connect` or `__version__` where it is first used, so that `deltaq --help` does not wait for them."""
    if name == "connect":
        from deltaq_protocol.client import connect

        return connect
    if name == "__version__":
        from importlib.metadata import version

        return version("deltaq")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
