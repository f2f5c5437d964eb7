"""The hands' quadratic programmes by several solvers, side by side: `python -m deltaq_experiments.qp_solvers`.

The programmes are those of a robot that is driven along each axis, as `deltaq_experiments.directions` does it. DAQP
comes with deltaq; the others are timed where they are installed.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import daqp
import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.live import model_of
from deltaq_controllers.modes.motion import ModeName
from deltaq_experiments.directions import commands, drive
from deltaq_launch.program import run_program
from deltaq_protocol.arrays import Array

EPS = 1e-9
"""Accuracy that is asked of solvers that iterate towards the answer, in the programmes' units (mm)."""
_EQUATION = 5
"""DAQP's kind of a row that is an equation."""
_UNBOUNDED = 1e20


class Programme(NamedTuple):
    """minimise x' hessian x / 2 + linear' x, where bounds and rows are kept.

    Attributes:
        hessian: (n, n).
        linear: (n,).
        rows: (m, n).
        high: (n + m,) of x, then of the rows.
        low: (n + m,) likewise.
        kinds: (n + m,) what DAQP calls each.
    """

    hessian: Array
    linear: Array
    rows: Array
    high: Array
    low: Array
    kinds: Array


class SolverTime(NamedTuple):
    """One solver's processor time, how far its answers are from DAQP's at most, and how many it did not find.

    All None where it is not installed.
    """

    solver: str
    median_us: float | None
    p99_us: float | None
    off: float | None
    failed: int | None


def programmes(cell: str, robot: str, mode: ModeName, duration_s: float, every: int) -> list[Programme]:
    """One in `every` of the programmes that a robot solves while it is driven along each axis.

    Raises:
        CellError: there is no such cell.
        ControllerError: there is no such robot, or it cannot be driven in that mode.
    """
    loaded = CellModel.load(cell)
    model = model_of(loaded.robots, robot)
    with _kept() as kept:
        for rates in commands(model):
            drive(model, mode, rates, duration_s, loaded.description.cycle_s, loaded)
    return kept[::every]


@contextmanager
def _kept() -> Iterator[list[Programme]]:
    """Programmes that are solved within the block."""
    found: list[Programme] = []
    solve = daqp.solve

    def keep(*given: Any) -> Any:
        if len(given) == len(Programme._fields):
            found.append(Programme(*(np.array(one) for one in given)))
        return solve(*given)

    daqp.solve = keep
    try:
        yield found
    finally:
        daqp.solve = solve


def by_daqp(one: Programme) -> Array | None:
    """DAQP's answer (n,)."""
    x, _, found, _ = daqp.solve(*one)
    return np.asarray(x) if found == 1 else None


def by_quadprog(one: Programme) -> Array | None:
    """That of quadprog, which has no bounds: they are rows."""
    quadprog = importlib.import_module("quadprog")
    every = np.vstack([np.eye(len(one.linear)), one.rows])
    equations = one.kinds == _EQUATION
    above, below = ~equations & (one.low > -_UNBOUNDED), ~equations & (one.high < _UNBOUNDED)
    rows = np.vstack([every[equations], every[above], -every[below]])
    least = np.concatenate([one.low[equations], one.low[above], -one.high[below]])
    try:
        x: Array = quadprog.solve_qp(one.hessian, -one.linear, rows.T, least, int(equations.sum()))[0]
    except ValueError:
        return None
    return x


def by_proxqp(one: Programme) -> Array | None:
    """That of ProxQP for dense programmes."""
    proxqp = importlib.import_module("proxsuite").proxqp
    n = len(one.linear)
    answer = proxqp.dense.solve(
        H=one.hessian,
        g=one.linear,
        C=one.rows,
        l=one.low[n:],
        u=one.high[n:],
        l_box=one.low[:n],
        u_box=one.high[:n],
        eps_abs=EPS,
    )
    return np.asarray(answer.x) if answer.info.status == proxqp.PROXQP_SOLVED else None


def by_piqp(one: Programme) -> Array | None:
    """That of PIQP for dense programmes."""
    piqp = importlib.import_module("piqp")
    n, solver = len(one.linear), piqp.DenseSolver()
    solver.settings.eps_abs = EPS
    hessian, rows = np.asfortranarray(one.hessian), np.asfortranarray(one.rows)
    solver.setup(
        hessian,
        one.linear,
        G=rows,
        h_l=one.low[n:],
        h_u=one.high[n:],
        x_l=one.low[:n],
        x_u=one.high[:n],
    )
    return np.asarray(solver.result.x) if solver.solve() == piqp.PIQP_SOLVED else None


def by_osqp(one: Programme) -> Array | None:
    """That of OSQP, which takes sparse programmes."""
    osqp, sparse = importlib.import_module("osqp"), importlib.import_module("scipy.sparse")
    solver = osqp.OSQP()
    rows = sparse.csc_matrix(np.vstack([np.eye(len(one.linear)), one.rows]))
    settings = {"eps_abs": EPS, "eps_rel": EPS, "max_iter": 20000, "polishing": True, "verbose": False}
    solver.setup(sparse.triu(one.hessian, format="csc"), one.linear, rows, one.low, one.high, **settings)
    answer = solver.solve(raise_error=False)
    return np.asarray(answer.x) if answer.info.status == "solved" else None


SOLVERS: dict[str, tuple[str, Callable[[Programme], Array | None]]] = {
    "DAQP": ("daqp", by_daqp),
    "quadprog": ("quadprog", by_quadprog),
    "ProxQP": ("proxsuite", by_proxqp),
    "PIQP": ("piqp", by_piqp),
    "OSQP": ("osqp", by_osqp),
}


def timed(asked: Sequence[Programme]) -> list[SolverTime]:
    """Every solver's times, each programme solved anew."""
    exact = [by_daqp(one) for one in asked]
    return [
        _timed(name, solve, asked, exact)
        if importlib.util.find_spec(package)
        else SolverTime(name, None, None, None, None)
        for name, (package, solve) in SOLVERS.items()
    ]


def _timed(
    name: str,
    solve: Callable[[Programme], Array | None],
    asked: Sequence[Programme],
    exact: Sequence[Array | None],
) -> SolverTime:
    solve(asked[0])  # what is loaded at the first time is no part of a step
    seconds, off, failed = [], 0.0, 0
    for one, best in zip(asked, exact, strict=True):
        begin = time.thread_time()
        x = solve(one)
        seconds.append(time.thread_time() - begin)
        if x is None:
            failed += 1
        elif best is not None:
            off = max(off, float(np.abs(x - best).max()))
    median, p99 = (1e6 * float(np.percentile(seconds, percent)) for percent in (50, 99))
    return SolverTime(name, median, p99, off, failed)


def main() -> None:
    """Print a line for each solver."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_experiments.qp_solvers", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--cell", default="dawm", help="name or file (default: %(default)s)")
    parser.add_argument("--robot", default="dawm", help="robot of it (default: %(default)s)")
    parser.add_argument(
        "--mode",
        default=ModeName.COUPLED.value,
        choices=(ModeName.DECOUPLED.value, ModeName.COUPLED.value),
        help="mode of the hands (default: %(default)s)",
    )
    parser.add_argument("--duration-s", type=float, default=4.0, help="of each axis (default: %(default)s)")
    parser.add_argument("--every", type=int, default=10, help="solve one programme in so many")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    given = parser.parse_args()
    if given.every < 1:
        parser.error(f"--every {given.every}: at least 1")
    asked = programmes(given.cell, given.robot, ModeName(given.mode), given.duration_s, given.every)
    if not asked:
        parser.error(f"--duration-s {given.duration_s:g}: too short, no programme was solved")
    found = timed(asked)
    if given.json:
        json.dump([one._asdict() for one in found], sys.stdout)
        return
    most = max(len(one.low) for one in asked), max(len(one.linear) for one in asked)
    print(f"{len(asked)} programmes, of up to {most[1]} variables and {most[0] - most[1]} rows")
    print(f"{'solver':10}{'median us':>10}{'p99 us':>10}{'off':>10}{'failed':>8}")
    for one in found:
        if one.median_us is None:
            print(f"{one.solver:10} is not installed")
        else:
            print(f"{one.solver:10}{one.median_us:10.0f}{one.p99_us:10.0f}{one.off:10.0e}{one.failed:8}")


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.qp_solvers")
