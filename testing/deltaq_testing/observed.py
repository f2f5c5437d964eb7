"""Findings about a run, by the independent checker: distances, limits, rest, reasons and tracking error."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.faults.report import Kept, is_good, judged
from deltaq_testing.oracle import TELEGRAM_STEP, ClearanceOracle, LeastDistance


@dataclass(frozen=True)
class RunFinding:
    """The result of a check; true if the check holds.

    Attributes:
        good: whether the check holds.
        told: the measured value and its bound, in words.
    """

    good: bool
    told: str

    def __bool__(self) -> bool:
        """Whether the check holds."""
        return self.good

    def __repr__(self) -> str:
        """What pytest shows of it."""
        return f"<{'yes' if self.good else 'no'}: {self.told}>"


@dataclass(frozen=True)
class JointTrackingError:
    """Error of a robot against a reference: that of the joint that is furthest off [rad or m].

    Attributes:
        max: at any time.
        rms: root mean square over time.
        final: in the end.
    """

    max: float
    rms: float
    final: float


DECIMALS_M = 1e-4
"""What the decimals of a telegram may take off a distance [m]."""
RESTS_CYCLES = 5
"""Cycles without motion after which a robot counts as at rest: one alone is a reply that was lost."""
_NOWHERE = (np.inf, np.inf)


class NothingObservedError(DeltaqError):
    """A question about a run that the run cannot answer."""


@dataclass
class RobotHistory:
    """The record of a robot, one row a cycle; the first row is before the cell's first cycle.

    Attributes:
        q: (n,) where it was [rad or m].
        setpoints: (n,) of the emulated controller [rad or m].
        phases: None while its server was dead.
        reasons: why it was held, where it was.
        unanswered, altered: KRC cycles without a valid reply, and telegrams with another digit, so far.
        protest: message with which the KRC refused a setpoint.
        krc_cycle_s: the KRC's cycle by its own record [s]; None where it is the cell's.
    """

    q: list[Array] = field(default_factory=list)
    setpoints: list[Array] = field(default_factory=list)
    phases: list[Phase | None] = field(default_factory=list)
    reasons: list[ReasonCode | None] = field(default_factory=list)
    unanswered: int = 0
    altered: int = 0
    protest: str | None = None
    krc_cycle_s: float | None = None


class Observed:
    """A recorded run of a cell, and the checks that a test makes of it.

    Args:
        model: the model of the cell.
        robot: the robot under test; checks of one robot are of this one.

    Attributes:
        model: the model of the cell.
        robot: the robot under test.
        history: the record of each robot, by name.
        ready_row: first row of the test in a record; earlier rows belong to the start of the cell.
        fault_rows: first row of each fault that has begun.
    """

    def __init__(self, model: CellModel, robot: str) -> None:
        self.model, self.robot = model, robot
        self.history = {name: RobotHistory() for name in model.robots}
        self.ready_row = 0
        self.fault_rows: list[int] = []

    @property
    def cycle_s(self) -> float:
        """The robots' sample time [s]."""
        return self.model.description.cycle_s

    @property
    def time_s(self) -> float:
        """Time since the beginning of the test [s]."""
        return (len(self._own.q) - 1 - self.ready_row) * self.cycle_s

    @property
    def home(self) -> Array:
        """Home configuration (n,), where a test begins [rad or m]."""
        return self.model.robots[self.robot].home

    @property
    def q(self) -> Array:
        """Measured configuration (n,) [rad or m]."""
        return self._own.q[-1]

    def kept_clear(self) -> RunFinding:
        """Whether all robots kept their stop distances to each other, to the structure and to themselves.

        Measured by an independent checker on every recorded configuration.
        """
        oracle, gate = ClearanceOracle(self.model), self.model.description.gate
        moments = self._moments()
        least = [
            (*_least(oracle.between_robots_and_structure, moments), gate.stop_distance_m),
            (*_least(oracle.of_one_robot, moments), gate.self_stop_distance_m),
        ]
        told, good = [], True
        for near, row, allowed_m in least:
            good = good and near.distance_m >= allowed_m - DECIMALS_M
            if np.isfinite(near.distance_m):
                told.append(
                    f"{' and '.join(near.pair)} came to {1000 * near.distance_m:.1f} mm at {self._time_s(row):.3f} s, "
                    f"at least {1000 * allowed_m:.1f} mm must be left"
                )
        return RunFinding(good, "; ".join(told) or "there are no two bodies that could touch")

    def kept_limits(self) -> RunFinding:
        """Whether all setpoints kept the limits of position, speed and acceleration, and the KRC refused none."""
        told, good = [], True
        for name, history in self.history.items():
            kept = self._kept(name, history)
            fine = is_good(kept, (0.0, 0.0))
            good = good and fine
            if not fine:
                told.append(
                    f"{name}: {kept.position_violations} setpoints beyond a joint limit, {kept.velocity_violations} "
                    f"too fast, {kept.abrupt_cycles} abrupt with {kept.unanswered_cycles} cycles unanswered"
                    + (f", and its KRC said {kept.protest!r}" if kept.protest else "")
                )
        return RunFinding(good, "; ".join(told) or "no limit was passed")

    def rested_within(self, cycles: int, after_s: float | None = None) -> RunFinding:
        """Whether the robot came to rest within a number of cycles.

        Args:
            cycles: between the beginning of the fault and the last motion before the rest; the brake may take them.
            after_s: counted from this time of the test [s]; None for the beginning of the first fault.

        Raises:
            NothingObservedError: there was no fault, and no time is given.
        """
        if after_s is None and not self.fault_rows:
            raise NothingObservedError(
                "no fault has started yet; give after_s, or run the cell past the first fault"
            )
        first = self.fault_rows[0] if after_s is None else self.ready_row + round(after_s / self.cycle_s)
        steps = np.abs(np.diff(np.array(self._own.setpoints[first:]), axis=0)).max(axis=1, initial=0.0)
        rest = _first_rest(steps)
        if rest is None:
            return RunFinding(False, f"still moving after {len(steps)} cycles; at most {cycles} were allowed")
        return RunFinding(
            rest <= cycles,
            f"at rest after {rest} cycles ({1000 * rest * self.cycle_s:.0f} ms); at most {cycles} were allowed",
        )

    def ended_at(self, goal: Sequence[float] | Array, within: float) -> RunFinding:
        """Whether the robot is within a tolerance of a goal.

        Args:
            goal: (n,) configuration [rad or m].
            within: largest error of a joint [rad or m].
        """
        off = np.abs(self.q - self._vector(goal, "goal"))
        worst = int(off.argmax())
        joint = self.model.robots[self.robot].joint_names[worst]
        return RunFinding(
            bool(off[worst] <= within), f"{joint} is {off[worst]:.4f} off; at most {within:g} were allowed"
        )

    def tracking_error(self, reference: Callable[[float], Sequence[float] | Array]) -> JointTrackingError:
        """Error of the robot against a reference over time.

        Args:
            reference: (n,) configuration [rad or m] from the time since the beginning of the test [s].
        """
        rows = np.array(self._own.q[self.ready_row :])
        wanted = [self._vector(reference(row * self.cycle_s), "reference") for row in range(len(rows))]
        off = np.abs(rows - np.array(wanted)).max(axis=1)
        return JointTrackingError(float(off.max()), float(np.sqrt(np.mean(off**2))), float(off[-1]))

    # --- how it is found out ------------------------------------------------------------------------------

    @property
    def _own(self) -> RobotHistory:
        return self.history[self.robot]

    def _time_s(self, row: int) -> float:
        return (row - self.ready_row) * self.cycle_s

    def _moments(self) -> list[dict[str, Array]]:
        names, rows = list(self.history), zip(*(history.q for history in self.history.values()), strict=True)
        return [dict(zip(names, row, strict=True)) for row in rows]

    def _kept(self, name: str, history: RobotHistory) -> Kept:
        return judged(
            self.model.robots[name],
            np.array(history.setpoints),
            history.krc_cycle_s or self.cycle_s,
            history.unanswered,
            _NOWHERE,
            history.protest,
            history.altered,
        )

    def _vector(self, values: Sequence[float] | Array, what: str) -> Array:
        vector, n = np.asarray(values, dtype=float), self.model.robots[self.robot].n
        if vector.shape != (n,):
            raise NothingObservedError(
                f"{what} must have {n} joints, one for each of {self.robot}, got {vector.shape}"
            )
        return vector


def _least(
    measure: Callable[[dict[str, Array]], LeastDistance], moments: list[dict[str, Array]]
) -> tuple[LeastDistance, int]:
    """The least distance, and its row."""
    found = [measure(moment) for moment in moments]
    row = min(range(len(found)), key=lambda one: found[one].distance_m)
    return found[row], row


def _first_rest(steps: Array) -> int | None:
    """Number of steps before the first rest; None if it never rests."""
    still = 0
    for place, step in enumerate(steps):
        still = still + 1 if step <= 2 * TELEGRAM_STEP else 0
        if still == RESTS_CYCLES:
            return place + 1 - RESTS_CYCLES
    return None
