"""Why no cell is up."""

from __future__ import annotations

from deltaq_protocol.errors import DeltaqError


class LaunchError(DeltaqError):
    """A service could not be started, or ended before it served."""


class LaunchInterruptedError(DeltaqError):
    """Somebody asked to stop while services were still starting."""
