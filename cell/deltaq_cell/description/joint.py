"""One joint: its limits, and what the gate may ask of it."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import FiniteFloat, model_validator

from deltaq_cell.description.base import DescriptionModel, Positive


class JointDescription(DescriptionModel):
    """Limits and home of one joint; either all in degrees (revolute) or all in metres (prismatic)."""

    home_deg: FiniteFloat | None = None
    lower_deg: FiniteFloat | None = None
    upper_deg: FiniteFloat | None = None
    max_velocity_deg_s: Positive | None = None
    max_acceleration_rad_s2: Positive | None = None
    tracking_tolerance_deg: Positive = 0.1
    """How far the joint may be off the hull of its setpoints; the gate's distances contain it."""
    home_m: FiniteFloat | None = None
    lower_m: FiniteFloat | None = None
    upper_m: FiniteFloat | None = None
    max_velocity_m_s: Positive | None = None
    max_acceleration_m_s2: Positive | None = None
    tracking_tolerance_m: Positive = 0.0005

    @model_validator(mode="after")
    def _has_one_unit_and_ordered_limits(self) -> Self:
        revolute = (self.home_deg, self.lower_deg, self.upper_deg, self.max_velocity_deg_s,
                    self.max_acceleration_rad_s2)  # fmt: skip
        prismatic = (self.home_m, self.lower_m, self.upper_m, self.max_velocity_m_s,
                     self.max_acceleration_m_s2)  # fmt: skip
        given = [all(v is not None for v in group) for group in (revolute, prismatic)]
        other = [any(v is not None for v in group) for group in (prismatic, revolute)]
        if not any(given) or (given[0] and other[0]) or (given[1] and other[1]):
            raise ValueError(
                "a joint needs home_deg, lower_deg, upper_deg, max_velocity_deg_s and "
                "max_acceleration_rad_s2 (revolute), or home_m, lower_m, upper_m, max_velocity_m_s and "
                "max_acceleration_m_s2 (prismatic), and none of the other kind"
            )
        if not self.lower < self.upper:
            raise ValueError(f"the lower limit {self.lower:g} must be below the upper limit {self.upper:g}")
        if not self.lower <= self.home <= self.upper:
            raise ValueError(f"home {self.home:g} must lie between {self.lower:g} and {self.upper:g}")
        return self

    @property
    def revolute(self) -> bool:
        """True for a revolute joint, False for a prismatic one."""
        return self.lower_deg is not None

    def _si(self, degrees: float | None, metres: float | None) -> float:
        if degrees is not None:
            return float(np.deg2rad(degrees))
        assert metres is not None  # the validator ensures it
        return metres

    @property
    def home(self) -> float:
        """Home position [rad or m]."""
        return self._si(self.home_deg, self.home_m)

    @property
    def lower(self) -> float:
        """Lower limit [rad or m]."""
        return self._si(self.lower_deg, self.lower_m)

    @property
    def upper(self) -> float:
        """Upper limit [rad or m]."""
        return self._si(self.upper_deg, self.upper_m)

    @property
    def max_velocity(self) -> float:
        """Largest speed [rad/s or m/s]."""
        return self._si(self.max_velocity_deg_s, self.max_velocity_m_s)

    @property
    def max_acceleration(self) -> float:
        """Largest acceleration and deceleration [rad/s^2 or m/s^2]."""
        value = self.max_acceleration_rad_s2 if self.revolute else self.max_acceleration_m_s2
        assert value is not None  # the validator ensures it
        return value

    @property
    def tracking_tolerance(self) -> float:
        """How far the measured joint may be off the commanded path [rad or m]."""
        return float(np.deg2rad(self.tracking_tolerance_deg)) if self.revolute else self.tracking_tolerance_m
