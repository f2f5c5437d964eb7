"""A camera whose view follows the requests in its robot's states: distance, targets, and the robot that it watches.

For each robot that can be watched there is a controller, made before anything moves: another leader costs no cycle.
"""

import math
from collections.abc import Mapping

import numpy as np

from deltaq_controllers.camera.controllers import Aiming, Bounded, FocusController, Seeing
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.surroundings.setpoints import LOST_S, Foreseen
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Sight, TargetPoint, ViewTarget, ViewWish
from deltaq_protocol.messages.motion import AIM_M

# What a camera is asked to look at, and which of several targets it looks at: the first that has been
# visible.

HIDDEN_S = 0.5
"""A target that has been hidden for so long is left: an arm that passes by is waited for [s]."""
VISIBLE_S = 1.0
"""A target that has been visible for so long again is returned to [s]."""
STEADY_S, LONGEST_S = 10.0, 60.0
"""A camera that turns to another target moves there, and may see the first from there but not from where it would look
at it. So a target that is hidden again within `STEADY_S` is returned to only after twice the time, but at most
`LONGEST_S` [s]."""


def targets_of(wish: ViewWish, started: ViewTarget, leader: str) -> tuple[ViewTarget, ...]:
    """All targets of a requested view, the most important one first.

    Args:
        wish: the requested view, as in the robot's states.
        started: the target with which the follower was started; it fills in omitted values.
        leader: the robot that is watched if neither names one.
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
    """Chooses the most important target that counts as visible.

    If none does, the choice stays. The first target counts as visible until it has been hidden for `HIDDEN_S`, each
    other one once it has been visible for `VISIBLE_S`, or longer if it was soon hidden again (`STEADY_S`).

    Args:
        count: how many targets there are, the most important one first.

    Attributes:
        chosen: index of the target to look at.
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
        """Note whether a target was visible.

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


OFF_M, OFF_RAD = 0.05, math.radians(10.0)
"""A view that is further off than one of these, in distance or angle, is not the requested one [m], [rad]."""
UNREACHED_S = 1.0
"""A view that has been off for so long and come no nearer is out of reach [s]."""

LEARNING_CYCLES = 3
"""Cycles that a controller observes before it takes over, to learn how fast the robots move."""
LOOK_S = 0.05
"""Time between two looks for a target; each look is for one of them, in turn. A look takes .3 ms [s]."""


class CameraInUse:
    """Camera controllers, one for each robot that can be watched; one of them is in use.

    Args:
        cameras: the controllers by their leaders.
        leader: the robot that is watched first.
        outlook: computes which bodies hide targets from the camera.

    Attributes:
        leader: the robot that is watched.
        evades_below_m: of the controller in use [m].
        hidden_by: names of the bodies that hid the target when it was looked for last.
        held_back_by: the bounds that keep the camera from the requested view; empty while it is in reach.
    """

    def __init__(self, cameras: Mapping[str, FocusController], leader: str, outlook: Outlook) -> None:
        self._cameras, self.leader, self._outlook = dict(cameras), leader, outlook
        self._next, self._learnt_cycles = leader, 0
        self._wish: ViewWish | None = None
        self.evades_below_m = self._camera.evades_below_m
        self._first_leader, self._started = leader, _target_of(self._camera, leader)
        self._targets: tuple[ViewTarget, ...] = (self._started,)
        self._choice = TargetChoice(1)
        self._looked_s, self._turn = -np.inf, 0
        self.hidden_by: tuple[str, ...] = ()
        self.held_back_by: tuple[str, ...] = ()
        self._off, self._nearer_s = math.inf, math.inf

    def take(self, wish: ViewWish | None) -> None:
        """Use a requested view from now on; a request that was taken before changes nothing."""
        if wish is None or wish == self._wish:
            return
        self._wish = wish
        if wish.distance_m is not None:
            self.desired_distance_m = wish.distance_m
        targets = targets_of(wish, self._started, self._first_leader)
        if targets != self._targets:
            self._targets, self._choice, self._turn = targets, TargetChoice(len(targets)), 0
            self._look_at(targets[0])

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        self._look(view)
        if self._next != self.leader:
            if self._learnt_cycles == LEARNING_CYCLES:
                self.leader = self._next
                self.evades_below_m = self._camera.evades_below_m
            else:
                self._cameras[self._next].increment(view)
                self._learnt_cycles += 1
        return self._camera.increment(view)

    @property
    def target(self) -> ViewTarget:
        """The present target."""
        return self._targets[self._choice.chosen]

    @property
    def sight(self) -> Sight | None:
        """How well the target is seen; None if the controller does not report how it sees its leader."""
        leader = self.leader_seen
        if leader is not None and leader.sight is not Sight.FRESH:
            return leader.sight
        if self._choice.is_hidden:
            return Sight.HIDDEN
        if self.held_back_by:
            return Sight.OUT_OF_REACH
        return None if leader is None else Sight.FRESH

    @property
    def desired_distance_m(self) -> float:
        """Desired view distance [m]."""
        return self._camera.desired_distance_m

    @desired_distance_m.setter
    def desired_distance_m(self, distance_m: float) -> None:
        for camera in self._cameras.values():
            camera.desired_distance_m = distance_m

    @property
    def leader_seen(self) -> Foreseen | None:
        """How the leader is seen; None if the controller does not report it."""
        return self._camera.leader_seen if isinstance(self._camera, Seeing) else None

    def errors(self, q: Array, q_leader: Array) -> tuple[float, float]:
        """View angle error [rad] and view distance less the desired one [m]."""
        return self._camera.errors(q, q_leader)

    def clearance(self, q: Array, q_leader: Array) -> float:
        """Least distance between the bodies that the controller keeps apart [m]."""
        return self._camera.clearance(q, q_leader)

    @property
    def _camera(self) -> FocusController:
        return self._cameras[self.leader]

    def _look(self, view: View) -> None:
        """Check the visibility of the next target, if it is due, and switch targets if the choice changes."""
        time_s = view.own.time_s
        if 0.0 <= time_s - self._looked_s < LOOK_S:
            return
        self._looked_s = time_s
        place, before = self._turn, self._choice.chosen
        self._turn = (place + 1) % len(self._targets)
        target = self._targets[place]
        if target.leader is not None and not _is_known(view.others.get(target.leader), time_s):
            hidden_by: tuple[str, ...] | None = None
        else:
            hidden_by = self._outlook.hidden_by(view, target)
        self._choice.saw(place, hidden_by == (), time_s)
        if place == self._choice.chosen:
            self.hidden_by = hidden_by or ()
        if self._choice.chosen != before:
            self._look_at(self.target)
        self._compare(view)

    def _compare(self, view: View) -> None:
        """Notice when the view has not come nearer to the requested one for `UNREACHED_S`, and what holds the arm back.

        A stretched arm meets no bound, nor does a law whose weights stop the joints before their limits.
        """
        time_s, other = view.own.time_s, view.others.get(self.leader)
        off = 0.0
        if other is not None:
            angle, distance = self.errors(view.own.q_cmd, other.q)
            off = max(angle / OFF_RAD, abs(distance) / OFF_M)
        if off < max(1.0, 0.9 * self._off) or time_s < self._nearer_s:
            self._off, self._nearer_s = off, time_s
        self.held_back_by = ()
        if time_s - self._nearer_s >= UNREACHED_S:
            met = self._camera.bounds_met if isinstance(self._camera, Bounded) else ()
            self.held_back_by = met or ("the arm's reach",)

    def _look_at(self, target: ViewTarget) -> None:
        """Turn to a target."""
        for camera in self._cameras.values():
            if isinstance(camera, Aiming):
                camera.focus = None if target.focus_m is None else np.array(target.focus_m)
                camera.aim_offset_m = np.array(target.aim_offset_m or AIM_M)
        if target.leader in self._cameras and target.leader != self._next:
            self._next, self._learnt_cycles = target.leader, 0


def _is_known(robot: RobotView | None, time_s: float) -> bool:
    """Whether the position of a robot is known."""
    return robot is not None and time_s - robot.time_s <= LOST_S


def _target_of(camera: FocusController, leader: str) -> ViewTarget:
    """The target given to a controller."""
    if not isinstance(camera, Aiming):
        return ViewTarget(leader=leader)
    if camera.focus is not None:
        return ViewTarget(focus_m=_point(camera.focus))
    offset_m = _point(camera.aim_offset_m)
    return ViewTarget(leader=leader, aim_offset_m=None if offset_m == AIM_M else offset_m)


def _point(point: Array) -> TargetPoint:
    x, y, z = np.asarray(point).tolist()
    return x, y, z
