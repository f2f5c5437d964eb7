"""The dead zone of a stick or a cap: where it counts as let go."""

from __future__ import annotations

import math

DEAD_ZONE = 0.12
"""Deflection below which it counts as let go; from there on it grows from zero."""


def beyond_dead_zone(share: float) -> float:
    """Deflection from -1 to 1, zero in the dead zone and continuous at its edge."""
    beyond = (abs(share) - DEAD_ZONE) / (1.0 - DEAD_ZONE)
    return math.copysign(min(1.0, beyond), share) if beyond > 0.0 else 0.0
