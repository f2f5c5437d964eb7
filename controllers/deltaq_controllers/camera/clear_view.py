"""The quadratic programme with a task for the line of sight: the lens moves aside until nothing hides the target.

    sight      (n . J_v) dq = step((margin - d) / (1 - s))

d is the distance between a body and the line from lens to focus, s the position on the line (0 to 1), and n the
direction that clears it, perpendicular to the line. To move the line by some distance at s, the lens has to move 1 /
(1 - s) times as far. The margin is half the distance between the eyes, less the farther along, so that both eyes see,
and a little more. Of all bodies the one that needs the longest displacement counts. Angle and distance leave the lens
two degrees of freedom, on a sphere round the focus; this task uses them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from deltaq_cell.sight_lines import BesideLine, SightLines
from deltaq_controllers.camera.outlook import moving_with
from deltaq_controllers.camera.qp_follower import QpFollower
from deltaq_controllers.camera.qp_problem import Tasks, available, step
from deltaq_protocol.arrays import Array


class SightGains(NamedTuple):
    """Gains of the line of sight.

    Attributes:
        clear_m: least distance of both eyes' lines from a body [m].
        share: part of the lens' displacement that a cycle takes, near the goal.
        most_m_s2: deceleration of the lens that is counted on [m/s^2].
        slow_m_s: a lens that moves aside no faster than this gets no farther [m/s].
        stalled_s: time after which such a lens tries the other side [s].
        weight: of the squared mm of the lens' displacement; a third of the view distance's. Chosen with seeds 20 to
            27: with a third of it both eyes saw less, with three times as much the distance was lost more.
    """

    clear_m: float = 0.01
    share: float = 0.05
    most_m_s2: float = 1.0
    slow_m_s: float = 0.01
    stalled_s: float = 1.0
    weight: float = 3e-3


class Side:
    """The side to which the lens moves: the nearer one, until the view is clear or the lens is blocked.

    Args:
        gains: define when the lens is blocked.
    """

    def __init__(self, gains: SightGains) -> None:
        self._gains = gains
        self._aside: Array | None = None
        self._stalled_s = 0.0

    def clear(self) -> None:
        """Note that the target is visible."""
        self._aside, self._stalled_s = None, 0.0

    def chosen(self, nearer: Array, moved: Array, cycle_s: float) -> Array:
        """(3,) unit vector, square to the line of sight.

        Args:
            nearer: (3,) the nearer direction that clears it.
            moved: (3,) how the lens moved in the last cycle [m].
            cycle_s: the cycle [s].
        """
        if self._aside is None:
            self._aside = nearer
        is_stalled = float(moved @ self._aside) < self._gains.slow_m_s * cycle_s
        self._stalled_s = self._stalled_s + cycle_s if is_stalled else max(self._stalled_s - cycle_s, 0.0)
        # past the middle of a body its nearer side is the one that the lens is on its way to
        onward = nearer if float(nearer @ self._aside) >= 0.0 else -nearer
        if self._stalled_s > self._gains.stalled_s:
            onward, self._stalled_s = -onward, 0.0
        self._aside = onward
        return onward


class ClearViewFollower(QpFollower):
    """The follower `QpFollower` with the task that keeps the line of sight clear; same arguments and attributes."""

    def _warm_up(self) -> None:
        self._sight = SightGains()
        self._lines = SightLines(self._scene.cell)
        camera = self._scene.robot.description.camera
        assert camera is not None  # there would be no follower
        self._half_baseline_m = 0.5 * camera.baseline_m
        self._housing = moving_with("camera", self._scene.robot)
        self._side = Side(self._sight)
        super()._warm_up()
        n = self._scene.robot.n
        self._with_sight(Tasks(np.zeros((0, n)), np.zeros(0), np.zeros(0)), 1.0, np.ones((1, n)))

    def _tasks(self, q: Array, dq_last: Array, focus: Array, velocity: Array, evade: bool) -> Tasks:
        tasks = super()._tasks(q, dq_last, focus, velocity, evade)
        if evade:  # evasion needs all the freedom that the view leaves
            self._side.clear()
            return tasks
        self._lines.place({self._scene.robot_name: q, **self._where_others_are()})
        beside = self._lines.beside(self._camera.position, focus, self._sight.clear_m + self._half_baseline_m)
        ways = [(self._way_m(body), body) for body in beside if body.name not in self._housing]
        way_m, body = max(ways, key=lambda way: way[0], default=(0.0, None))
        if body is None or way_m <= 0.0:
            self._side.clear()
            return tasks
        J_v = self._camera.at_point(self._camera.position)
        aside = self._side.chosen(body.aside, J_v @ dq_last, self._cycle_s)
        return self._with_sight(tasks, way_m, (aside @ J_v)[None])

    def _with_sight(self, tasks: Tasks, way_m: float, row: Array) -> Tasks:
        """The tasks, and that the lens moves so far along a row (1, n)."""
        gains, share = self._sight, self.gains.brake_share
        deceleration = available(row, self.limits.max_ddq, np.ones(1))
        wanted = step(way_m, gains.share, min(deceleration, gains.most_m_s2 * self._cycle_s**2), share)
        return Tasks(
            np.concatenate([tasks.rows, row]),
            np.append(tasks.wanted, wanted),
            np.append(tasks.weights, gains.weight),
        )

    def _way_m(self, body: BesideLine) -> float:
        """How far the lens has to move until both eyes' lines pass a body [m]."""
        rest = 1.0 - body.share
        margin = self._sight.clear_m + rest * self._half_baseline_m
        return math.inf if rest <= 0.0 else (margin - body.distance_m) / rest

    def _where_others_are(self) -> dict[str, Array]:
        """(n,) of each other robot with a state, at the time when the increment takes effect [rad or m]."""
        heard = {
            name: self._others.named(name)
            for name in self._scene.cell.robots
            if name != self._scene.robot_name
        }
        return {name: other.ahead() for name, other in heard.items() if other.setpoints.started}
