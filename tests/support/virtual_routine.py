"""Routines in virtual time: the interpreter against the whole stack, its requests carried out at once."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera import FOLLOWS
from deltaq_controllers.camera.controllers import camera_controller_named
from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.routines.planner import PlanRequest, RoutinePlanner
from deltaq_controllers.routines.routine import Job, RoutineError
from deltaq_controllers.routines.run import (
    AllowRequest,
    RoutineAnswer,
    RoutineRequest,
    RoutineRun,
    SeenCycle,
    SwitchRequest,
    sight_of_equipment,
)
from deltaq_protocol import messages
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Done, Phase
from deltaq_testing.oracle import ClearanceOracle
from deltaq_testing.virtual_cell.cell import VirtualCell

MEASURED_EVERY = 5
"""Cycles between two measurements of clearance and sight."""
LONGEST_S = 400.0


@dataclass
class Record:
    """What was measured of a run.

    Attributes:
        seconds: length of the run.
        room_m: least distance beyond the stop distances; pairs count that may not touch at that time.
        touched: the contact was allowed in so many measurements.
        hidden, looked: looks at which the camera's target was hidden, of so many.
    """

    seconds: float = 0.0
    room_m: float = np.inf
    touched: int = 0
    hidden: int = 0
    looked: int = 0
    hidden_by: Counter[str] = field(default_factory=Counter)


class VirtualRoutine:
    """A cell in which routines are run.

    Attributes:
        contacts: that are allowed now.

    Args:
        cell: its name or file.
        start: (n,) configuration of robots that do not start at home.
        follows: the other robot follows with its camera.
    """

    def __init__(
        self,
        cell: str = "lab",
        start: Mapping[str, Array] | None = None,
        follows: str | None = None,
        controller: str = FOLLOWS,
    ) -> None:
        self.stack = VirtualCell(cell, start)
        self.model: CellModel = self.stack.cell
        self.camera: CameraInUse | None = None
        self.follower = follows
        if follows is not None:
            others = {name: Scene(self.model, follows, name) for name in self.model.robots if name != follows}
            cameras = {
                name: camera_controller_named(controller, scene, 1.25) for name, scene in others.items()
            }
            self._outlook = Outlook(self.model, follows)
            self.camera = CameraInUse(cameras, next(iter(cameras)), self._outlook)
        self.stack.run_until_ready()
        if follows is not None:
            self.stack.acquire(follows, "camera")
        self.oracle = ClearanceOracle(self.model)
        self.contacts: set[str] = set()

    def run(
        self,
        job: Job,
        first: int = 0,
        each: Callable[[RoutineRun, int], None] = lambda _run, _cycle: None,
        longest_s: float = LONGEST_S,
    ) -> tuple[RoutineRun, Record]:
        """Run a job, or the rest of it; `each` is called every cycle before the robot is asked."""
        description = self.model.description
        run = RoutineRun(
            job, self.model.robots[job.robot], description.gate.servo_lag_s, description.cycle_s, first
        )
        planner, record = RoutinePlanner(self.model, job), Record()
        self.stack.acquire(job.robot, "routine")
        before: tuple[float, ...] | None = None
        for cycle in range(round(longest_s / description.cycle_s)):
            self.stack.cycle()
            each(run, cycle)
            states = self.stack.states
            views = {name: RobotView.from_state(state) for name, state in states.items()}
            if cycle % MEASURED_EVERY == 0:
                self._measure(job, record, views)
            if self.camera is not None and self.follower is not None:
                self.camera.take(states[self.follower].view)
                self.stack.ask(self.follower, self.camera.increment(_view(views, self.follower)))
            own = states[job.robot]
            seen = SeenCycle(
                _view(views, job.robot),
                before == own.q_cmd,
                str(own.reason) if own.phase is Phase.HELD else "",
                self._sight(states),
            )
            before = own.q_cmd
            out = run.advance(seen)
            # a client in virtual time renews its lease only by asking
            dq = out if isinstance(out, np.ndarray) else np.zeros(len(own.q))
            verdict = self.stack.ask(job.robot, dq)
            if isinstance(out, np.ndarray):
                run.take_verdict(verdict)
            elif out is not None:
                run.take(self._carried_out(out, planner, job, views))
            if run.end is not None:
                record.seconds = cycle * description.cycle_s
                break
        return run, record

    def reset(self, robot: str) -> None:
        """Let the cell come to rest, and reset a robot."""
        for _ in range(100):
            self.stack.cycle()
        answers = self.stack.reset(robot)
        for _ in range(20):
            self.stack.cycle()
        assert isinstance(answers[0], Done), answers

    def _sight(self, states: Mapping[str, messages.RobotState]) -> messages.Sight | None:
        if self.camera is None or self.follower is None:
            return None
        q = np.array(states[self.follower].q)
        return sight_of_equipment(self.model.robots[self.follower], q, self.camera.sight, self.camera.target)

    def _carried_out(
        self, request: RoutineRequest, planner: RoutinePlanner, job: Job, views: Mapping[str, RobotView]
    ) -> RoutineAnswer:
        others = {name: view.q_cmd for name, view in views.items() if name != job.robot}
        try:
            if isinstance(request, PlanRequest):
                return planner.plan(request, others)
            if isinstance(request, SwitchRequest):
                # outputs need a lease's token, which the stepped client keeps to itself
                return dict.fromkeys(self.model.description.robots[job.robot].inputs, False)
            if isinstance(request, AllowRequest):
                self._ask(messages.ContactRequest(contact=request.contact, allowed=request.allowed))
                (self.contacts.add if request.allowed else self.contacts.discard)(request.contact)
            elif job.camera is not None:
                wish = planner.view(request.at_equipment, others)
                self._ask(messages.ViewRequest(robot=job.camera, **wish.model_dump(exclude_none=True)))
        except RoutineError as error:
            return error
        return None

    def _ask(self, request: messages.Message) -> None:
        answers = self.stack.request(request)
        for _ in range(20):
            if answers:
                break
            self.stack.cycle()
        assert isinstance(answers[0], Done | messages.ViewReply), answers

    def _measure(self, job: Job, record: Record, views: Mapping[str, RobotView]) -> None:
        contacts = self.model.description.contacts
        pairs = [pair for name in self.contacts for pair in contacts[name].pairs]
        record.touched += bool(pairs)
        q = {name: arm.q for name, arm in self.stack.arms.items()}
        record.room_m = min(record.room_m, self.oracle.least_room_m(q, self.oracle.levels_m(pairs)))
        if self.camera is not None and self.follower is not None:
            record.looked += 1
            hidden = self._outlook.hidden_by(_view(views, self.follower), self.camera.target)
            record.hidden += bool(hidden)
            record.hidden_by.update(hidden[:1])


def _view(views: Mapping[str, RobotView], robot: str) -> View:
    return View(views[robot], {name: view for name, view in views.items() if name != robot})
