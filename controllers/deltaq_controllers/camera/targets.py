"""What a camera is asked to look at, and which of several targets it looks at: the first that has been visible."""

from __future__ import annotations

import math

from deltaq_protocol.messages import ViewTarget, ViewWish

HIDDEN_S = 0.5
"""A target that has been hidden for so long is left: an arm that passes by is waited for [s]."""
VISIBLE_S = 1.0
"""A target that has been visible for so long again is returned to [s]."""
STEADY_S, LONGEST_S = 10.0, 60.0
"""A camera that turns to another target moves there, and may see the first from there but not from where it would look
at it. So a target that is hidden again within `STEADY_S` is returned to only after twice the time, but at most
`LONGEST_S` [s]."""


def targets_of(wish: ViewWish, started: ViewTarget, leader: str) -> tuple[ViewTarget, ...]:
    """All targets of a wish, the most important one first.

    Args:
        wish: as the robot's states tell it.
        started: the target with which the follower was started: what the wish leaves out is taken from it.
        leader: the robot that is watched where neither says which.
    """
    if wish.targets is not None:
        return wish.targets
    if wish.focus_m is not None:
        return (ViewTarget(focus_m=wish.focus_m),)
    if wish.leader is None and wish.aim_offset_m is None:
        return (started,)
    offset_m = started.aim_offset_m if wish.aim_offset_m is None else wish.aim_offset_m
    return (ViewTarget(leader=wish.leader or started.leader or leader, aim_offset_m=offset_m),)


class TargetChoice:
    """Chooses among targets by what was seen of each: the most important one that counts as visible.

    If none does, the choice stays. The first target counts as visible until it has been hidden for `HIDDEN_S`, each
    other one once it has been visible for `VISIBLE_S`, or longer where that did not last (`STEADY_S`).

    Args:
        count: how many targets there are, the most important one first.

    Attributes:
        chosen: place of the target that is to be looked at.
    """

    def __init__(self, count: int) -> None:
        self.chosen = 0
        self._counts = [place == 0 for place in range(count)]
        self._counts_since_s = [-math.inf] * count
        self._was_visible: list[bool | None] = [None] * count
        self._since_s = [0.0] * count
        self._waits_s = [VISIBLE_S] * count

    @property
    def is_hidden(self) -> bool:
        """Whether the chosen target counts as hidden."""
        return not self._counts[self.chosen]

    def saw(self, place: int, is_visible: bool, time_s: float) -> None:
        """A target was looked for, and found visible or not.

        Args:
            place: of the target.
            is_visible: whether it is.
            time_s: stamp of the own robot's state; one that is earlier than those before begins anew [s].
        """
        if is_visible is not self._was_visible[place] or time_s < self._since_s[place]:
            self._was_visible[place], self._since_s[place] = is_visible, time_s
        waits_s = self._waits_s[place] if is_visible else HIDDEN_S
        if is_visible is not self._counts[place] and time_s - self._since_s[place] >= waits_s:
            self._count(place, is_visible, time_s)

    def _count(self, place: int, is_visible: bool, time_s: float) -> None:
        if not is_visible:
            lasted = not 0.0 <= time_s - self._counts_since_s[place] < STEADY_S
            self._waits_s[place] = VISIBLE_S if lasted else min(2.0 * self._waits_s[place], LONGEST_S)
        self._counts[place], self._counts_since_s[place] = is_visible, time_s
        self.chosen = next((first for first, counts in enumerate(self._counts) if counts), self.chosen)
