"""An option to practise with."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.advisor.advisor import Option
from deltaq_controllers.criteria.near_bodies import Clearance
from deltaq_controllers.inverse.tracking import ConstraintTracker

_NEAR = 0.01
"""Distance of the option from home, in every base joint [rad or m]."""


def near_home(tracker: ConstraintTracker) -> Option:
    """The base joints a little off the robot's home."""
    home = tracker.robot.home
    end = home.copy()
    end[tracker.base] += _NEAR
    clearance = Clearance(room_m=0.0, distance_m=0.0, pair=("", ""))
    return Option(
        end,
        energy=0.0,
        values={},
        costs={},
        clearance=clearance,
        nearest_limit="",
        limit_share=0.0,
        hands_move=False,
        start=home,
        path=np.array([home, end]),
        no_path="",
    )
