"""One quadratic programme per cycle, over the robot's increment and one slack.

    minimise    sum_i w_i |A_i dq - b_i|^2 + rest |dq / ddq_max|^2 + price s
    subject to  slowest <= dq <= fastest,  C dq + s >= c,  s >= 0

It always has a solution: `slowest <= fastest` leaves at least the brake, and s takes up whatever the barriers ask
for beyond it. The solver is quadprog's dual active-set method (Goldfarb and Idnani, 1983): exact to rounding for
programmes of this size, and with nothing carried from one cycle to the next, so that the same view gives the same
increment, bit for bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from quadprog import solve_qp

Array = NDArray[np.float64]

_MILLI = 1e3
"""Costs count in mm and mrad, so that the solver's numbers are near one."""

_SLACK_SCALE = 1e-2
"""The slack's unit [m]: its numbers are then of the size of the others'."""


class QuadraticProgram:
    """The programme of one robot.

    Args:
        scale: (n,) unit of each increment, its acceleration limit over a cycle [rad or m].
        rest_weight: cost of the squared increments in these units.
        price: cost of the slack [1/m].
    """

    def __init__(self, scale: Array, rest_weight: float, price: float) -> None:
        n = len(scale)
        self._scale, self._n = scale, n
        self._hessian = np.zeros((n + 1, n + 1))
        self._linear = np.zeros(n + 1)
        self._rest = rest_weight * np.eye(n)
        self._price = price * _SLACK_SCALE
        # the slack's own square keeps the programme strictly convex
        self._hessian[n, n] = 1e-6 * self._price
        self._linear[n] = -self._price
        self._bounds = np.hstack([np.eye(n + 1), -np.eye(n + 1)[:, :n]])

    def solve(
        self,
        rows: Array,
        wanted: Array,
        weights: Array,
        slowest: Array,
        fastest: Array,
        barriers: Array,
        least: Array,
    ) -> tuple[Array, float] | None:
        """The best increment, and the slack that it needs.

        Args:
            rows: (t, n) change of each task per increment.
            wanted: (t,) change asked for [rad or m].
            weights: (t,) cost of a squared mrad or mm.
            slowest: (n,) least increment [rad or m].
            fastest: (n,) greatest increment [rad or m].
            barriers: (k, n) change of each distance per increment.
            least: (k,) least change of the distance [m].

        Returns:
            (n,) increment within its bounds and the slack [m]; None if the solver found none.
        """
        n, k = self._n, len(least)
        scaled = rows * self._scale
        heavy = (weights * _MILLI**2)[:, None] * scaled
        self._hessian[:n, :n] = 2.0 * (scaled.T @ heavy + self._rest)
        self._linear[:n] = 2.0 * (wanted @ heavy)
        # a column for each bound of the increments and of the slack, then for each barrier
        columns = np.ones((n + 1, 2 * n + 1 + k))
        columns[:, : 2 * n + 1] = self._bounds
        columns[:n, 2 * n + 1 :] = (barriers * (self._scale / _SLACK_SCALE)).T
        low = np.concatenate([slowest / self._scale, [0.0], -fastest / self._scale, least / _SLACK_SCALE])
        try:
            solution = solve_qp(self._hessian, self._linear, columns, low)[0]
        except ValueError:  # rounding made it inconsistent
            return None
        if not np.isfinite(solution).all():
            return None
        dq = np.minimum(np.maximum(self._scale * solution[:n], slowest), fastest)
        return dq, max(0.0, float(solution[n]) * _SLACK_SCALE)
