"""Systems that are broken on purpose: the explorer must find each of them out, or it shows nothing."""

import copy
from dataclasses import dataclass, replace

from deltaq_proofs.model_checker.attacked import AttackedSystem
from deltaq_proofs.model_checker.one_joint import IPOC_STEP, ROBOT, STEP
from deltaq_proofs.model_checker.rsi_line import KRC_AT, Program
from deltaq_proofs.model_checker.safety_monitor import Property
from deltaq_proofs.model_checker.system import System
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.guarded import Admission, Request, ServerState, Supervision, TrackerMemory
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.rsi import KrcTelegram
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.guards import Refusal
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.robot_server.session import (
    Belief,
    DatagramSource,
    Judgement,
    Peer,
    Session,
    TelegramKind,
)
from deltaq_services.sim.core import Sim
from deltaq_services.sim.inbox import Inbox
from deltaq_services.sim.orders import Orders
from deltaq_services.sim.tracker import Tracker


class _TakesLate(RobotServer):
    def _keep(self, admission: Admission) -> None:
        super()._keep(admission.model_copy(update={"cycle": self._cycle}))


class LateIsTaken(System):
    """The Robot Server takes an admission whatever cycle it was for."""

    def _new_server(self, process: int) -> RobotServer:
        return _TakesLate(self._description, ROBOT, process)


class _LooksAtNoChain(RobotServer):
    def _refused(self, admission: Admission, state: ServerState) -> Refusal | None:
        follows = {
            "follows_sequence": state.sequence,
            "follows_q_cmd": state.q_cmd,
            "follows_dq": state.dq,
            "follows_resets": state.resets,
        }
        return super()._refused(admission.model_copy(update=follows), state)


class ChainIsNotLookedAt(System):
    """The Robot Server takes an admission in its cycle, whatever has become of the one that it follows."""

    def __init__(self) -> None:
        super().__init__(lookahead_cycles=2)

    def _new_server(self, process: int) -> RobotServer:
        return _LooksAtNoChain(self._description, ROBOT, process)


class _ResetsAtOnce(RobotServer):
    def _supervise(self, supervision: Supervision | None, measured: Measurement) -> None:
        motion = self._motion
        self._motion = replace(motion, step=motion.brake_cycles)
        super()._supervise(supervision, measured)
        self._motion = replace(self._motion, step=motion.step)


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
    def _supervise(self, supervision: Supervision | None, measured: Measurement) -> None:
        self._cycles_without_gate = 0
        super()._supervise(supervision, measured)


class SilentGateIsIgnored(System):
    """The Robot Server never takes the gate for lost."""

    def _new_server(self, process: int) -> RobotServer:
        return _NeverLosesTheGate(self._description, ROBOT, process)


class _ForgetsAdmissions(Tracker):
    def snapshot(self) -> TrackerMemory:
        return super().snapshot().model_copy(update={"in_flight": ()})


class AdmissionIsForgotten(System):
    """The gate does not reckon with an admission before a state confirms it."""

    def _new_sim(self) -> Sim:
        return self._sim_with(_ForgetsAdmissions, Orders)


class _KeepsWhatWasTaken(Inbox):
    def cycle_passed(self, cycle: int, missed: bool) -> Request | None:
        return super().cycle_passed(cycle, missed=True)


class TakenStaysInHand(System):
    """The gate keeps an increment in hand though its admission was taken."""

    def _new_sim(self) -> Sim:
        return self._sim_with(Tracker, Orders, _KeepsWhatWasTaken)


class _OutlivesStops(Inbox):
    def forget(self) -> Request | None:
        return None


class HandOutlivesStop(System):
    """What is in hand when a stop or a reset comes is used after it."""

    def _new_sim(self) -> Sim:
        return self._sim_with(Tracker, Orders, _OutlivesStops)


class _OutlivesLeases(Inbox):
    def heartbeat(self, request: Request, newest_cycle: int) -> Request | None:
        lease_epoch = self.lease_epoch
        return super().heartbeat(request.model_copy(update={"lease_epoch": lease_epoch}), newest_cycle)


class HandOutlivesLease(System):
    """What is in hand when its lease ends is used after that."""

    def _new_sim(self) -> Sim:
        return self._sim_with(Tracker, Orders, _OutlivesLeases)


class _TakesSessions(RobotServer):
    def _begin_session(self, q: Array, q_start: Array, resumes: bool) -> None:
        super()._begin_session(q, q_start, resumes)
        if self._q_reset is not None:
            self._motion, self._q_reset = replace(self._motion, q_cmd=self._q_reset), None


class SessionIsTakenInAnyPhase(AttackedSystem):
    """A new session moves the setpoint to where it begins, without a reset."""

    def _new_server(self, process: int) -> RobotServer:
        return _TakesSessions(self._description, ROBOT, process)


class _LooksAtNoSender(Peer):
    def judge(self, sender: Address, now_s: float) -> DatagramSource:
        super().judge(sender, now_s)
        return DatagramSource.KRC


class SenderIsNotLookedAt(AttackedSystem):
    """Datagrams of anybody are read."""

    def _new_program(self) -> Program:
        driver, _ = super()._new_program()
        return driver, _LooksAtNoSender(KRC_AT[0], self._description.gate.krc_timeout_s)


class _BelievesAtOnce(Session):
    def judge(self, telegram: KrcTelegram, time_s: float) -> Judgement:
        if self._kind(telegram, time_s)[0] is TelegramKind.FOREIGN:
            self.belief = Belief.DOUBTED
        return super().judge(telegram, time_s)

    def _confirmed(self, time_s: float) -> bool:
        return time_s >= 0.0

    def believe(self, telegram: KrcTelegram, time_s: float) -> None:
        super().believe(telegram, time_s)
        self.step = IPOC_STEP  # which one telegram does not tell


class OneTelegramIsBelieved(AttackedSystem):
    """One telegram that does not belong to the session is enough for another.

    While a Robot Server remembers the correction of the true session this moves nothing, since that session is believed
    at once again. One that has just started remembers none, and takes a forged one for the first.
    """

    def _new_program(self) -> Program:
        driver, peer = super()._new_program()
        believing = copy.copy(driver.session)
        believing.__class__ = _BelievesAtOnce
        driver.session = believing
        return driver, peer


class _GoesOnFromMissed(RobotServer):
    def cycle(
        self,
        measured: Measurement,
        time_s: float,
        admission: Admission | None = None,
        supervision: Supervision | None = None,
    ) -> Array:
        made_up = STEP * (measured.missed_last and bool(self._motion.dq.any()))
        self._motion = replace(self._motion, q_cmd=self._motion.q_cmd + made_up)
        return super().cycle(measured, time_s, admission, supervision)


class MissedReplyIsMadeUpFor(AttackedSystem):
    """The Robot Server makes up for a reply that the KRC did not get."""

    def _new_server(self, process: int) -> RobotServer:
        return _GoesOnFromMissed(self._description, ROBOT, process)


@dataclass(frozen=True, slots=True)
class SeededBug:
    """One broken system, the property it breaks, and how many faults it takes to see it."""

    system: type[System]
    breaks: Property
    faults: int


BROKEN: tuple[SeededBug, ...] = (
    SeededBug(LateIsTaken, Property.CERTIFIED, 1),
    SeededBug(ChainIsNotLookedAt, Property.KNOWN, 1),
    SeededBug(ResetIgnoresRest, Property.LATCHED, 0),
    SeededBug(StopIsNotLatched, Property.NOTICED, 0),
    SeededBug(MissedReplyIsForgotten, Property.CERTIFIED, 1),
    SeededBug(SilentGateIsIgnored, Property.NOTICED, 2),
    SeededBug(AdmissionIsForgotten, Property.KNOWN, 1),
    SeededBug(TakenStaysInHand, Property.ONCE, 0),
    SeededBug(HandOutlivesStop, Property.ONCE, 1),
    SeededBug(HandOutlivesLease, Property.ONCE, 1),
    SeededBug(SessionIsTakenInAnyPhase, Property.CERTIFIED, 0),
    SeededBug(SenderIsNotLookedAt, Property.UNHEARD, 0),
    SeededBug(OneTelegramIsBelieved, Property.EXPLAINED, 1),
    SeededBug(MissedReplyIsMadeUpFor, Property.CERTIFIED, 0),
)
"""Every broken system."""
