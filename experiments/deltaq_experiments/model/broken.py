"""Systems that are broken on purpose: the explorer must find each of them out, or it shows nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from deltaq_experiments.model.ledger import Property
from deltaq_experiments.model.one_joint import ROBOT
from deltaq_experiments.model.system import System
from deltaq_protocol.guarded import Admission, Plan, ServerState, Supervision, TrackerMemory
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.core import Sim
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker

Array = NDArray[np.float64]


class _TakesLate(RobotServer):
    def _take(self, admission: Admission, follows: ServerState | None) -> bool:
        if follows is not None:
            admission = admission.model_copy(update={"cycle": follows.cycle})
        return super()._take(admission, follows)


class LateIsTaken(System):
    """The Robot Server takes an admission whatever cycle it was for."""

    def _new_server(self, process: int) -> RobotServer:
        return _TakesLate(self._description, ROBOT, process)


class _ResetsAtOnce(RobotServer):
    def _supervise(self, supervision: Supervision | None) -> None:
        plan = self._plan
        self._plan = Plan(dq=plan.dq, brake_cycles=1, step=1)
        super()._supervise(supervision)
        self._plan = plan


class _AlwaysAtRest(Tracker):
    def at_rest(self) -> bool:
        return True


class ResetIgnoresRest(System):
    """The Robot Server obeys a reset while the robot still brakes, and the gate gives it."""

    def _new_server(self, process: int) -> RobotServer:
        return _ResetsAtOnce(self._description, ROBOT, process)

    def _new_sim(self) -> Sim:
        return self._sim_with(_AlwaysAtRest, Orders)


class _ForgetsStops(Orders):
    def judge(self) -> None:
        super().judge()
        if self.standing_stop is ReasonCode.OPERATOR_STOP:
            self.standing_stop = None


class StopIsNotLatched(System):
    """The gate forgets a stop before the robot has shown it."""

    def _new_sim(self) -> Sim:
        return self._sim_with(Tracker, _ForgetsStops)


class _StepsTwice(RobotServer):
    def cycle(
        self,
        measured: Measurement,
        time_s: float,
        admission: Admission | None = None,
        supervision: Supervision | None = None,
    ) -> Array:
        return super().cycle(replace(measured, missed_last=False), time_s, admission, supervision)


class MissedReplyIsForgotten(System):
    """The Robot Server goes on though the KRC did not get its last reply."""

    def _new_server(self, process: int) -> RobotServer:
        return _StepsTwice(self._description, ROBOT, process)


class _NeverLosesTheGate(RobotServer):
    def _supervise(self, supervision: Supervision | None) -> None:
        self._cycles_without_gate = 0
        super()._supervise(supervision)


class SilentGateIsIgnored(System):
    """The Robot Server never takes the gate for lost."""

    def _new_server(self, process: int) -> RobotServer:
        return _NeverLosesTheGate(self._description, ROBOT, process)


class _ForgetsAdmissions(Tracker):
    def memory(self) -> TrackerMemory:
        return super().memory().model_copy(update={"in_flight": None})


class AdmissionIsForgotten(System):
    """The gate does not reckon with an admission before a state confirms it."""

    def _new_sim(self) -> Sim:
        return self._sim_with(_ForgetsAdmissions, Orders)


@dataclass(frozen=True, slots=True)
class Broken:
    """One broken system, the property it breaks, and how many faults it takes to see it."""

    system: type[System]
    breaks: Property
    faults: int


BROKEN: tuple[Broken, ...] = (
    Broken(LateIsTaken, Property.CERTIFIED, 1),
    Broken(ResetIgnoresRest, Property.LATCHED, 0),
    Broken(StopIsNotLatched, Property.NOTICED, 0),
    Broken(MissedReplyIsForgotten, Property.CERTIFIED, 1),
    Broken(SilentGateIsIgnored, Property.NOTICED, 2),
    Broken(AdmissionIsForgotten, Property.KNOWN, 1),
)
"""Every broken system."""
