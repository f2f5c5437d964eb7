"""What is told of ways that are offered: options of the advisor, or the way to a pose."""

from __future__ import annotations

import numpy as np

from deltaq_controllers.advisor.advisor import Option
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import MOST_WAY_POINTS, NearPair, Search, Way

_DECIMALS = 5
"""Of what is only drawn [rad or m]."""


def option_way(rank: int, option: Option) -> Way:
    """An option of the advisor; its rank counts from 1."""
    return Way(
        rank=rank,
        q=joints(option.q),
        points=() if option.path is None else points(option.path),
        why_not="" if option.path is not None else option.no_path,
        energy=option.energy,
        energy_here=option.energy_here if np.isfinite(option.energy_here) else None,
        costs=option.costs,
        near={
            kind.name.lower(): NearPair(distance_m=one.distance_m, pair=one.pair)
            for kind, one in option.nearest.items()
        },
        hands_leave=option.hands_leave,
        clearance_m=option.clearance.distance_m,
        pair=option.clearance.pair,
        nearest_limit=option.nearest_limit,
        limit_share=option.limit_share,
    )


def advisor_of(teleoperator: Teleoperator) -> AdvisorMode | None:
    """The mode `advisor`, if it drives now."""
    made = next((mode for mode in teleoperator.made_modes if mode.name is teleoperator.mode), None)
    return made if isinstance(made, AdvisorMode) else None


def search_of(mode: AdvisorMode) -> Search:
    """How far the search of an advisor's mode is, and the robot on the way that was begun."""
    progress = mode.search
    return Search(
        doing="" if progress is None else progress.doing,
        done=0.0 if progress is None else min(1.0, max(0.0, progress.done)),
        is_busy=mode.is_searching,
        trials=0 if progress is None else progress.trials,
        way=mode.begun,
        driven=round(mode.driven, 3),
        arrived=mode.is_at_end,
        trade_off=mode.trade_off,
        hands_may_leave=mode.hands_may_leave,
    )


def points(path: Array) -> tuple[tuple[float, ...], ...]:
    """Configurations of a path (P, n), no more than are sent, including its ends."""
    count = min(len(path), MOST_WAY_POINTS)
    return tuple(joints(path[index]) for index in np.linspace(0, len(path) - 1, count).round().astype(int))


def joints(q: Array) -> tuple[float, ...]:
    """A configuration (n,), in the form in which it is drawn."""
    return tuple(np.round(q, _DECIMALS).tolist())
