"""One quadratic programme per cycle, over the robot's increment and a slack for each kind of barrier.

    minimise    sum_i w_i |A_i dq - b_i|^2 + rest |dq / ddq_max|^2 + price . s
    subject to  slowest <= dq <= fastest,  C dq + S s >= c,  s >= 0

S picks the slack of each barrier's kind, so that what one kind needs does not loosen the others. The programme
always has a solution: `slowest <= fastest` leaves at least the brake, and s takes up whatever the barriers demand
beyond it. The solver is DAQP's dual active-set method (Arnström, Bemporad and Axehill, 2022, IEEE TAC 67(8)): exact
to rounding for programmes of this size, and with no state carried from one cycle to the next, so that the same view
gives the same increment, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import daqp
import numpy as np

from deltaq_cell.compiled import compiled
from deltaq_controllers.camera.qp_tasks import Tasks
from deltaq_controllers.surroundings.barriers import Barriers
from deltaq_protocol.arrays import Array

_MILLI = 1e3
"""Costs count in mm and mrad, so that the solver's numbers are near one."""

_UNBOUNDED = 1e30
"""The solver's value for no bound."""

_SLACK_SCALE = 1e-2
"""The slack's unit [m]: its numbers are then of the size of the others'."""


class QuadraticProgram:
    """The programme of one robot.

    Args:
        scale: (n,) unit of each increment, its acceleration limit over a cycle [rad or m].
        rest_weight: cost of the squared increments in these units.
        prices: (m,) cost of the slack of each kind of barrier [1/m].
    """

    def __init__(self, scale: Array, rest_weight: float, prices: Sequence[float]) -> None:
        n, m = len(scale), len(prices)
        self._scale, self._rest_weight = scale, rest_weight
        self._hessian = np.zeros((n + m, n + m))
        self._linear = np.zeros(n + m)
        price = np.array(prices) * _SLACK_SCALE
        # the slacks' own squares keep the programme strictly convex
        self._hessian[n:, n:] = np.diag(1e-6 * price)
        self._linear[n:] = price

    def solve(
        self,
        tasks: Tasks,
        slowest: Array,
        fastest: Array,
        barriers: Barriers,
    ) -> tuple[Array, Array] | None:
        """The best increment, and the slacks that it needs.

        Args:
            tasks: what it is for.
            slowest: (n,) least increment [rad or m].
            fastest: (n,) greatest increment [rad or m].
            barriers: what to keep, kinds being indices of `prices`.

        Returns:
            (n,) increment within its bounds and (m,) slacks [m]; None if the solver found none.
        """
        n = len(self._scale)
        _cost(tasks, self._scale, self._rest_weight, self._hessian, self._linear)
        rows, low, high = _constraints(self._scale, len(self._linear), slowest, fastest, barriers)
        solution, _, found, _ = daqp.solve(self._hessian, self._linear, rows, high, low)
        if found != 1 or not np.isfinite(solution).all():  # rounding made it inconsistent
            return None
        dq = np.minimum(np.maximum(self._scale * solution[:n], slowest), fastest)
        return dq, np.maximum(_SLACK_SCALE * solution[n:], 0.0)


@compiled
def _cost(tasks: Tasks, scale: Array, rest_weight: float, hessian: Array, linear: Array) -> None:
    """Write the tasks' cost into `hessian` (n + m, n + m) and `linear` (n + m,), which know the slacks' already."""
    for i in range(len(scale)):
        linear[i] = 0.0
        for j in range(len(scale)):
            hessian[i, j] = 2.0 * rest_weight if i == j else 0.0
    for task in range(len(tasks.weights)):
        scaled = tasks.rows[task] * scale
        heavy = (2.0 * tasks.weights[task] * _MILLI**2) * scaled
        for i in range(len(scale)):
            linear[i] -= heavy[i] * tasks.wanted[task]
            for j in range(len(scale)):
                hessian[i, j] += heavy[i] * scaled[j]


@compiled
def _constraints(
    scale: Array, count: int, slowest: Array, fastest: Array, barriers: Barriers
) -> tuple[Array, Array, Array]:
    """A row for each barrier, and what the increments, the slacks and then the barriers have to keep.

    Returns:
        (k, count) rows, and (count + k,) least and greatest values; `count` is n + m.
    """
    n, least, kinds = len(scale), barriers.least, barriers.kinds
    rows = np.zeros((len(least), count))
    low, high = np.zeros(count + len(least)), np.full(count + len(least), _UNBOUNDED)
    for i in range(n):
        low[i], high[i] = slowest[i] / scale[i], fastest[i] / scale[i]
    for k in range(len(least)):
        rows[k, :n] = barriers.rows[k] * scale / _SLACK_SCALE
        rows[k, n + kinds[k]] = 1.0
        low[count + k] = least[k] / _SLACK_SCALE
    return rows, low, high
