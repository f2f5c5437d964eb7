"""The interpreter of routines. Pure: what is seen goes in, an increment or a request comes out.

A request (a plan, outputs, a contact, a view) is carried out by its caller, who hands the answer in; the robot rests
meanwhile.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from deltaq_cell.robot import RobotModel
from deltaq_controllers.camera.error import view_angle
from deltaq_controllers.interface import View
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.operated.reach import advisor_of
from deltaq_controllers.routines.planner import PlannedMotion, PlanRequest, lines_after
from deltaq_controllers.routines.routine import Condition, Job, PlainStep, RoutineError
from deltaq_protocol.arrays import Array
from deltaq_protocol.driving import OperatorCommand
from deltaq_protocol.messages import Sight, Verdict, ViewTarget

STUCK_S = 2.0
"""A motion that comes no further for so long is planned anew from where it is [s]."""
PLANS = 4
"""Times that one motion is planned before it has failed."""
AGAIN_S = 0.5
"""Time before a motion that could not be planned is planned again: the other robot may have gone on [s]."""
LOOK_S = 0.25
"""Time between two readings of the inputs that a condition names [s]."""
SETTLED = 2e-3
"""The drives are at the setpoint within this [rad or m]."""


class RunEnd(StrEnum):
    """How a step, or a routine, ended."""

    DONE = "done"
    AT_END_STOP = "at_end_stop"
    FAILED = "failed"
    HELD = "held"
    LEFT = "left"
    ABORTED = "aborted"
    PLANNED = "planned"


@dataclass(frozen=True)
class SwitchRequest:
    """Digital outputs to set; none: read the inputs. The answer is the inputs by name."""

    outputs: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True)
class AllowRequest:
    """The equipment's contact, to be allowed or forbidden."""

    contact: str
    allowed: bool


@dataclass(frozen=True)
class CoupleRequest:
    """The equipment's tool, to be coupled or released, or the bare tool changer, to be opened."""

    action: str
    tool: str


@dataclass(frozen=True)
class LookRequest:
    """What the camera looks at: the equipment, or the tool of the robot that works."""

    at_equipment: bool


RoutineRequest = PlanRequest | SwitchRequest | AllowRequest | CoupleRequest | LookRequest
RoutineAnswer = PlannedMotion | Mapping[str, bool] | RoutineError | None


@dataclass(frozen=True)
class SeenCycle:
    """What the interpreter sees in one cycle.

    Attributes:
        view: states of the robots; `time_s` of the own one is the only clock.
        is_still: whether the setpoint rests, and nothing that was sent will move it.
        held: why the robot is held; empty if it is not.
        sight: how well the camera sees the equipment; None if it looks at something else, or nobody follows.
    """

    view: View
    is_still: bool
    held: str = ""
    sight: Sight | None = None


def sight_of_equipment(
    camera: RobotModel, q: Array, sight: Sight | None, target: ViewTarget | None
) -> Sight | None:
    """How well a camera sees the equipment, with its robot at `q` (n,); None if its target is not the equipment.

    It counts as seen also from another distance than the one asked for, as long as it is in the picture.
    """
    if target is None or target.focus_m is None:
        return None
    if sight is Sight.OUT_OF_REACH:
        T_world_camera, described = camera.camera_pose(q), camera.description.camera
        angle_rad = view_angle(T_world_camera[:3, :3], T_world_camera[:3, 3], np.array(target.focus_m))
        if described is not None and angle_rad < np.deg2rad(0.5 * described.vertical_view_deg):
            return Sight.FRESH
    return sight


@dataclass(frozen=True)
class StepOutcome:
    """How one step went.

    Attributes:
        number: of the step, from 1; those that give a routine up count on.
        text: what it was to do.
        end: how it ended.
        seconds: how long it took, on the robot's clock.
        why: the reason, if it was not done.
        clearance_m: least distance that its path was planned with; None for a step without a motion.
        pair: the bodies that come so near.
        sight: how well the camera saw what it was to look at.
    """

    number: int
    text: str
    end: RunEnd
    seconds: float
    why: str = ""
    clearance_m: float | None = None
    pair: tuple[str, str] | None = None
    sight: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """As a JSON object."""
        return {**asdict(self), "seconds": round(self.seconds, 3)}


@dataclass
class _StepState:
    """State of the present step.

    Attributes:
        seconds: since it began, pauses left out.
        holds_since_s: since when its condition has held.
        motion: that is being driven.
        planned: the last motion that was planned for it.
        plans: how often it was planned.
        again_s: when it is planned again.
        furthest, stuck_s: share of the motion that was reached, and when.
        answered: its request has been carried out.
        stops_early: its condition has ended the motion.
        refused: why its request was refused.
        fails: why it has failed.
        limit: what limited its motion last.
        sight: how well the camera saw what its condition names.
    """

    seconds: float = 0.0
    holds_since_s: float = 0.0
    motion: PlannedMotion | None = None
    planned: PlannedMotion | None = None
    plans: int = 0
    again_s: float = 0.0
    furthest: float = 0.0
    stuck_s: float = 0.0
    answered: bool = False
    stops_early: bool = False
    refused: str = ""
    fails: str = ""
    limit: str = ""
    sight: Sight | None = None


class RoutineRun:
    """One run of a routine.

    Args:
        job: the routine, resolved.
        robot: model of the robot that does it.
        servo_lag_s: how long the drives may be behind a setpoint.
        cycle_s: the robot's cycle.
        first: index of the step to begin with, as `place` gave it when another run ended.

    Attributes:
        outcomes: of the steps so far.
        end: how the run ended; None while it lasts.
        why: the reason, if it did not end as it should.
        contact_allowed: whether the run allows the equipment's contact now.
        done: share of the present motion that has been driven.
    """

    def __init__(
        self, job: Job, robot: RobotModel, servo_lag_s: float, cycle_s: float, first: int = 0
    ) -> None:
        self._job, self._steps = job, list(job.steps)
        self._now = first
        self._tolerance = robot.description.tracking_tolerance
        self._setpoints: deque[Array] = deque(maxlen=max(1, round(servo_lag_s / cycle_s)) + 1)
        self.outcomes: list[StepOutcome] = []
        self.end: RunEnd | None = None
        self.why = ""
        self.contact_allowed = False
        self._wants_contact = _contact_before(self._steps, first)
        self._ended_round: int | None = None
        self._paused, self._given_up = False, ""
        self._is_aborting = False
        self._asked: RoutineRequest | None = None
        self._inputs: Mapping[str, bool] = {}
        self._inputs_s = -np.inf
        self._seen_s: float | None = None
        self._at = _StepState()

    @property
    def place(self) -> int:
        """Index of the step at which another run takes up the routine; the number of its steps if all are done."""
        return len(self._job.steps) if self._is_aborting else self._now

    @property
    def present(self) -> PlainStep | None:
        """The present step."""
        return self._steps[self._now] if self._now < len(self._steps) else None

    @property
    def is_paused(self) -> bool:
        """Whether it was told to wait."""
        return self._paused

    @property
    def done(self) -> float:
        """Share of the present motion that has been driven."""
        return 0.0 if self._at.motion is None else _mode_of(self._at.motion).driven

    def pause(self, paused: bool = True) -> None:
        """Come to rest and wait, or go on; time limits wait too."""
        self._paused = paused

    def leave(self, why: str) -> None:
        """Come to rest, and end where the routine can be taken up again."""
        self._given_up = self._given_up or why

    def lose(self, why: str) -> None:
        """End at once: the robot can no longer be moved."""
        if self.end is None:
            self._close(RunEnd.LEFT, why)

    def abort(self) -> None:
        """Come to rest, do what brings the robot to a safe pose, and end."""
        if not self._is_aborting and self.end is None:
            self._is_aborting, self._paused = True, False

    def take(self, answer: RoutineAnswer) -> None:
        """Take the answer to the request that `advance` returned."""
        asked, self._asked = self._asked, None
        if isinstance(answer, RoutineError):
            self._at.refused = str(answer)
        elif isinstance(asked, PlanRequest):
            assert isinstance(answer, PlannedMotion)  # what a plan is answered with
            self._at.motion = self._at.planned = answer
            self._at.stuck_s = self._at.seconds
        elif isinstance(asked, SwitchRequest):
            assert isinstance(answer, Mapping)  # what outputs are answered with
            self._inputs, self._at.answered = answer, True
        elif isinstance(asked, AllowRequest):
            self.contact_allowed = asked.allowed
            self._at.answered = self._step.step.contact is not None
        else:
            self._at.answered = True

    def take_verdict(self, verdict: Verdict | None) -> None:
        """Take the verdict on an increment."""
        if self._at.motion is not None:
            self._at.motion.teleoperator.take_verdict(verdict)
            limit = self._at.motion.teleoperator.limitation
            self._at.limit = limit.text if limit is not None else self._at.limit

    def advance(self, seen: SeenCycle) -> Array | RoutineRequest | None:
        """The increment (n,) for this cycle [rad or m], a request, or None: rest."""
        own = seen.view.own
        self._setpoints.append(own.q_cmd)
        waited_s, self._seen_s = self._passed(own.time_s), own.time_s
        if self.end is not None or self._asked is not None:
            return None
        if seen.held:
            self._close(RunEnd.HELD, seen.held)
            return None
        if self._paused or self._given_up or (self._is_aborting and self._now < len(self._job.steps)):
            return self._rest(seen)
        self._at.seconds += waited_s
        if self._at.seconds > self._step.step.within_s and not self._at.fails:
            self._at.fails = f"took longer than its limit, {self._step.step.within_s:g} s{self._because}"
        if self._at.fails:
            return self._rest(seen)
        return self._do(seen)

    # --- steps --------------------------------------------------------------------------------------------

    @property
    def _step(self) -> PlainStep:
        return self._steps[self._now]

    @property
    def _because(self) -> str:
        waits = self._step.step.wait_for
        if waits is not None and waits.sight is not None and self._at.sight is None:
            return " (no camera looks at it; start one with `deltaq camera follow`)"
        why = self._at.limit or (f"the camera's sight is {self._at.sight}" if self._at.sight else "")
        return f" ({why})" if why else ""

    def _begin(self) -> None:
        """Begin the present step."""
        self._at = _StepState()

    def _passed(self, time_s: float) -> float:
        return 0.0 if self._seen_s is None else max(0.0, time_s - self._seen_s)

    def _do(self, seen: SeenCycle) -> Array | RoutineRequest | None:
        step, contact = self._step.step, self._job.item.contact if self._job.item is not None else None
        if self._at.refused:
            why, self._at.refused = self._at.refused, ""
            self._at.again_s = self._at.seconds + AGAIN_S
            if not self._at.plans or self._at.plans == PLANS:
                self._at.fails = why
            return None
        taken_up = self._wants_contact and not self.contact_allowed and not self._at.answered
        if taken_up and contact is not None:
            return self._ask(AllowRequest(contact, allowed=True))
        if step.move_to is not None or step.move_tool is not None:
            return self._move(seen)
        if step.wait_for is not None:
            reading = self._reading(step.wait_for, seen)
            if reading is None and self._holds(step.wait_for, seen):
                self._finish(RunEnd.DONE)
            return reading
        if self._at.answered:
            self._wants_contact = self._wants_contact if step.contact is None else step.contact == "allow"
            self._finish(RunEnd.DONE)
            return None
        if step.io is not None:
            return self._ask(SwitchRequest(step.io))
        if step.contact is not None:
            assert contact is not None  # the job was checked
            return self._ask(AllowRequest(contact, step.contact == "allow"))
        if step.tool is not None:
            assert self._job.item is not None  # the job was checked
            return self._ask(CoupleRequest(step.tool, self._job.item.tool or ""))
        return self._ask(LookRequest(step.look == "equipment"))

    def _ask(self, request: RoutineRequest) -> RoutineRequest:
        self._asked = request
        return request

    def _move(self, seen: SeenCycle) -> Array | RoutineRequest | None:
        until = self._step.step.until
        if until is not None and self._at.motion is not None and not self._at.stops_early:
            self._at.stops_early = self._holds(until, seen)
        if self._at.stops_early:
            increment = self._driven(seen, rest=True)
            if increment is None:
                self._finish(RunEnd.AT_END_STOP)
            return increment
        if self._at.motion is None:
            if not seen.is_still or self._at.seconds < self._at.again_s:
                return None
            if self._at.plans == PLANS:
                self._at.fails = f"planned {PLANS} times, and stuck each time{self._because}"
                return None
            self._at.plans += 1
            ahead = lines_after(self._steps, self._now, self._touching)
            return self._ask(PlanRequest(self._step, seen.view.own.q_cmd.copy(), self._touching, ahead))
        mode = _mode_of(self._at.motion)
        if mode.is_at_end and seen.is_still and np.abs(seen.view.own.q - seen.view.own.q_cmd).max() < SETTLED:
            self._finish(RunEnd.DONE)
            return None
        if mode.driven > self._at.furthest or mode.is_at_end:
            self._at.furthest, self._at.stuck_s = mode.driven, self._at.seconds
        elif self._at.seconds - self._at.stuck_s > STUCK_S:
            increment = self._driven(seen, rest=True)
            if increment is None:
                self._at.motion, self._at.furthest, self._at.stuck_s = None, 0.0, self._at.seconds
            return increment
        return self._driven(seen, rest=False)

    @property
    def _touching(self) -> bool:
        return self._wants_contact and self.contact_allowed

    def _driven(self, seen: SeenCycle, rest: bool) -> Array | None:
        """The increment along the motion, or to rest on it; None at rest."""
        if self._at.motion is None:
            return None
        driver, view = self._at.motion.teleoperator, seen.view
        if seen.is_still:  # another client may have moved it: the difference to the last view is no increment
            if rest and driver.is_at_rest:
                return None
            view = replace(view, own=replace(view.own, dq=np.zeros_like(view.own.q_cmd)))
        driver.command = OperatorCommand() if rest else OperatorCommand(option=1)
        return driver.increment(view)

    def _rest(self, seen: SeenCycle) -> Array | None:
        """Come to rest; once there, what was to happen at rest happens."""
        increment = self._driven(seen, rest=True)
        if increment is not None or not seen.is_still:
            return increment
        self._at.stuck_s = self._at.seconds
        if self._given_up:
            self._close(RunEnd.LEFT, self._given_up)
        elif self._at.fails:
            self._close(RunEnd.FAILED, self._at.fails)
        elif self._is_aborting:
            self._note(RunEnd.ABORTED)
            self._steps = [*self._job.steps, *self._job.abort]
            self._now = len(self._job.steps)
            self._begin()
            if not self._job.abort:
                self._over(RunEnd.ABORTED)
        return None

    # --- conditions ---------------------------------------------------------------------------------------

    def _reading(self, condition: Condition, seen: SeenCycle) -> RoutineRequest | None:
        """A request for the inputs, where a condition names some and they were not read lately."""
        if not condition.inputs or seen.view.own.time_s - self._inputs_s < LOOK_S:
            return None
        self._inputs_s = seen.view.own.time_s
        return self._ask(SwitchRequest())

    def _holds(self, condition: Condition, seen: SeenCycle) -> bool:
        """Whether a condition has held for as long as it says."""
        holds = all(self._inputs.get(name) is is_on for name, is_on in condition.inputs.items())
        if condition.sight is not None:
            self._at.sight = seen.sight
            holds = holds and self._at.sight is condition.sight
        if condition.drive_lag is not None:
            holds = holds and self._lag(seen.view.own.q) >= condition.drive_lag
        if not holds:
            self._at.holds_since_s = self._at.seconds
        return holds and self._at.seconds - self._at.holds_since_s >= float(condition.for_s)

    def _lag(self, q: Array) -> float:
        """By how much a joint is outside of the setpoints of the drives' lag, as a share of its tracking tolerance."""
        if len(self._setpoints) < (self._setpoints.maxlen or 0):
            return 0.0
        setpoints = np.array(self._setpoints)
        off = np.maximum(setpoints.min(axis=0) - q, q - setpoints.max(axis=0))
        return float((off / self._tolerance).max())

    # --- ends ---------------------------------------------------------------------------------------------

    def _finish(self, end: RunEnd) -> None:
        self._note(end)
        round_now = self._step.round
        if end is RunEnd.AT_END_STOP and round_now:
            self._ended_round = round_now
        self._now += 1
        while self._ended_round is not None and self._now < len(self._steps):
            following = self._steps[self._now].round
            if following <= self._ended_round:
                self._ended_round = self._ended_round if following else None
                break
            self._now += 1
        if self._now == len(self._steps):
            self._over(RunEnd.ABORTED if self._is_aborting else RunEnd.DONE)
        else:
            self._begin()

    def _note(self, end: RunEnd, why: str = "") -> None:
        planned = self._at.planned
        sight = self._at.sight
        self.outcomes.append(
            StepOutcome(
                number=self._now + 1,
                text=self._step.text,
                end=end,
                seconds=self._at.seconds,
                why=why,
                clearance_m=None if planned is None else planned.clearance.distance_m,
                pair=None if planned is None else planned.clearance.pair,
                sight=None if sight is None else sight.value,
            )
        )

    def _close(self, end: RunEnd, why: str) -> None:
        self._note(end, why)
        self._over(end, f"step {self._now + 1} of {len(self._steps)}, {self._step.text}: {why}")

    def _over(self, end: RunEnd, why: str = "") -> None:
        self.end, self.why = end, why


def _mode_of(motion: PlannedMotion) -> AdvisorMode:
    mode = advisor_of(motion.teleoperator)
    assert mode is not None  # the planner made it
    return mode


def _contact_before(steps: list[PlainStep], first: int) -> bool:
    """Whether the contact is allowed where a run begins with the step of an index."""
    switched = [plain.step.contact for plain in steps[:first] if plain.step.contact is not None]
    return bool(switched) and switched[-1] == "allow"
