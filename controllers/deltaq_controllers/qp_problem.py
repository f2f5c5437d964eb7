"""One quadratic programme per cycle, over the robot's increment and one slack.

    minimise    sum_i w_i |A_i dq - b_i|^2 + rest |dq / ddq_max|^2 + price s
    subject to  slowest <= dq <= fastest,  C dq + s >= c,  s >= 0

It always has a solution: `slowest <= fastest` leaves at least the brake, and s takes up whatever the barriers ask
for beyond it. The solver is ProxQP (proxsuite), started from the solution of the cycle before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from proxsuite import proxqp

Array = NDArray[np.float64]

_FREE = 1e20
"""A bound that is none."""

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
        most: how many barriers there can be.
    """

    def __init__(self, scale: Array, rest_weight: float, price: float, most: int) -> None:
        n = len(scale)
        self._scale, self._n, self._most = scale, n, most
        self._hessian = np.zeros((n + 1, n + 1))
        self._gradient = np.zeros(n + 1)
        self._rest = rest_weight * np.eye(n)
        self._price = price * _SLACK_SCALE
        self._rows = np.zeros((most, n + 1))
        self._least, self._none = np.full(most, -_FREE), np.full(most, _FREE)
        self._low, self._high = np.zeros(n + 1), np.full(n + 1, _FREE)
        self._solver = proxqp.dense.QP(n + 1, 0, most, True)
        settings = self._solver.settings
        settings.eps_abs, settings.eps_rel, settings.max_iter = 1e-6, 0.0, 200
        settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._started = False

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
            (n,) increment within its bounds and the slack [m]; None if the solver did not come to an end.
        """
        n, k = self._n, len(least)
        scaled = rows * self._scale
        heavy = (weights * _MILLI**2)[:, None] * scaled
        self._hessian[:n, :n] = 2.0 * (scaled.T @ heavy + self._rest)
        # the slack's own square keeps the programme strictly convex
        self._hessian[n, n] = 1e-6 * self._price
        self._gradient[:n] = -2.0 * (wanted @ heavy)
        self._gradient[n] = self._price
        self._rows[:, :] = 0.0
        self._least[:] = -_FREE
        self._rows[:k, :n] = barriers * (self._scale / _SLACK_SCALE)
        self._rows[:k, n] = 1.0
        self._least[:k] = least / _SLACK_SCALE
        self._low[:n], self._high[:n] = slowest / self._scale, fastest / self._scale
        problem = (self._hessian, self._gradient, None, None, self._rows, self._least, self._none)
        if self._started:
            self._solver.update(*problem, self._low, self._high)
        else:
            self._solver.init(*problem, self._low, self._high)
            self._started = True
        self._solver.solve()
        result = self._solver.results
        if result.info.status != proxqp.QPSolverOutput.PROXQP_SOLVED or not np.isfinite(result.x).all():
            self._started = False
            return None
        dq = np.minimum(np.maximum(self._scale * result.x[:n], slowest), fastest)
        return dq, max(0.0, float(result.x[n]) * _SLACK_SCALE)
