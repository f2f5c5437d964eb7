"""Runs a routine on a running cell: the shell of the interpreter, and the record of runs."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.answers import Answers
from deltaq_controllers.interface import View
from deltaq_controllers.live import cell_model, where_others_are
from deltaq_controllers.modes.practice import practise
from deltaq_controllers.operated.reach import points
from deltaq_controllers.routines.planner import (
    PlannedMotion,
    PlanRequest,
    RoutinePlanner,
    lines_after,
    with_present_tools,
)
from deltaq_controllers.routines.routine import Job, RoutineError, job_for
from deltaq_controllers.routines.run import (
    AllowRequest,
    CoupleRequest,
    RoutineAnswer,
    RoutineRequest,
    RoutineRun,
    RunEnd,
    SeenCycle,
    StepOutcome,
    SwitchRequest,
    sight_of_equipment,
)
from deltaq_protocol.client import Cell
from deltaq_protocol.driving import MOST_WAY_POINTS, RoutineProgress, Way
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.leased_robot import LeasedRobot
from deltaq_protocol.messages import Phase, RobotState
from deltaq_protocol.reasons import EXPLANATIONS

SILENT_S = 2.0
"""A routine ends when no state of its robot has come for so long [s]."""
MOST_LINES = 1000
"""Runs that are kept in a cell's record."""
_RUN_FIELDS = {"time", "routine", "source", "equipment", "robot", "numbers", "end", "why", "place", "steps"}
"""Of a recorded run, those that are read again."""


class LiveRoutine:
    """A routine on a running cell.

    Args:
        cell: connection to the cell.
        routine: its name, or a YAML file.
        equipment: the item; empty if the routine needs none.
        robot: the robot; empty for the one that the item names, or that the camera watches.
        first: index of the step to begin with.
        numbers: parameters of the routine.

    Attributes:
        job: the routine, resolved.
        run: its interpreter.

    Raises:
        RoutineError: it cannot be done in this cell.
    """

    def __init__(
        self,
        cell: Cell,
        routine: str | Path,
        equipment: str = "",
        robot: str = "",
        first: int = 0,
        numbers: Mapping[str, float] | None = None,
    ) -> None:
        self._cell, self._source, self._allowed = cell, str(routine), ""
        self._model: CellModel = cell_model(cell.description)
        description = self._model.description
        self.job: Job = job_for(description, routine, equipment, robot, **(numbers or {}))
        self._coupled = cell.description.coupled
        _check_tool(self.job, self._coupled)
        if not 0 <= first < len(self.job.steps):
            raise RoutineError(
                f"step {first + 1}: {self.job.routine} has {len(self.job.steps)} steps; the run is over"
            )
        self._planner = self._planner_now()
        self._carrying: asyncio.Task[RoutineAnswer] | None = None
        self._noting: asyncio.Task[None] | None = None
        self._noted = 0
        self._motions: list[PlannedMotion] = []
        self._others = where_others_are(cell, self.job.robot)
        model = self._model.robots[self.job.robot]
        self.run = RoutineRun(self.job, model, description.gate.servo_lag_s, description.cycle_s, first)

    def _planner_now(self) -> RoutinePlanner:
        return RoutinePlanner(with_present_tools(self._model, self.job, self._coupled), self.job)

    async def drive(self, leased: LeasedRobot, watch: Callable[[RoutineRun], None] = lambda _: None) -> None:
        """Drive the robot until the run is over; the contact is forbidden then, and the run recorded.

        Args:
            leased: the robot of the job.
            watch: called with the run in every cycle.

        Raises:
            RefusedError: the lease was lost.
            ServiceUnreachableError: the HLI or the Robot Server is gone.
        """
        answers, before, loop = Answers(self._cell, leased), None, asyncio.get_running_loop()
        try:
            async with asyncio.timeout(SILENT_S) as silence:
                async for state in leased.states():
                    silence.reschedule(loop.time() + SILENT_S)
                    cycles = await answers.due(state)
                    stood, before = before == state.q_cmd, state.q_cmd
                    await self.answer(leased, answers, state, cycles, stood)
                    watch(self.run)
                    if self.run.end is not None:
                        return
        except TimeoutError:
            why = (
                f"no state of {self.job.robot} for {SILENT_S:g} s; is its Robot Server up (`deltaq status`)?"
            )
            self.run.lose(why)
            raise ServiceUnreachableError(why) from None
        finally:
            await self.close()

    async def answer(
        self,
        leased: LeasedRobot,
        answers: Answers,
        state: RobotState,
        cycles: Sequence[int],
        stood: bool,
    ) -> None:
        """Answer a state in the cycles that are due; `stood` says that the setpoint has not moved since the last."""
        if self._carrying is not None and self._carrying.done():
            self.run.take(self._carrying.result())
            self._carrying = None
        for cycle in cycles:
            view = answers.view(state)
            rests = stood and state.q_cmd == tuple(view.own.q_cmd.tolist())
            out = self.run.advance(self._seen(state, view, rests))
            if isinstance(out, RoutineRequest):
                self._carrying = asyncio.create_task(self._carried_out(leased, out))
            elif out is not None:
                await answers.send(state, cycle, out)
        for verdict in answers.verdicts():
            self.run.take_verdict(verdict)
        if self._noted < len(self.run.outcomes) and (self._noting is None or self._noting.done()):
            self._noting = asyncio.create_task(self._note(leased))

    async def _note(self, leased: LeasedRobot) -> None:
        """Have the outcomes of steps kept in the audit log and in recordings."""
        while self._noted < len(self.run.outcomes):
            outcome, why = self.run.outcomes[self._noted], ""
            self._noted += 1
            if outcome.why:
                why = f": {outcome.why}"
            text = f"step {outcome.number} of {len(self.job.steps)}, {outcome.text}: {outcome.end}{why}"
            with suppress(DeltaqError):  # the robot goes on without
                await leased.io(note=f"{self.job.routine} {self.job.equipment}".strip() + f", {text}")

    async def close(self) -> None:
        """Forbid the contact, and record the run; one that has not ended can no longer go on."""
        self.run.lose("the lease or the connection was lost")
        if self._carrying is not None:
            self._carrying.cancel()
        if self._allowed:
            with suppress(DeltaqError):
                await self._cell.allow_contact(self._allowed, allowed=False)
        if self._noting is not None:
            await self._noting
        self._record()

    @property
    def progress(self) -> RoutineProgress:
        """How far the run is."""
        run = self.run
        return RoutineProgress(
            routine=self.job.routine,
            equipment=self.job.equipment,
            step=run.place,
            steps=len(self.job.steps),
            text="" if run.present is None or run.end is not None else run.present.text,
            done=round(min(1.0, run.done), 2),
            paused=run.is_paused,
            end="" if run.end is None else run.end.value,
            why=run.why,
        )

    async def rehearse(self) -> dict[str, Any]:
        """Plan every motion from where the robot is, nothing moving; the report, with the gate's first verdict.

        Raises:
            RoutineError: a motion cannot be planned.
        """
        robot = self.job.robot
        async for state in self._cell.states(robot):
            q, touching, gate = np.array(state.q_cmd), False, ""
            break
        for number, plain in enumerate(self.job.steps):
            touching = touching if plain.step.contact is None else plain.step.contact == "allow"
            if plain.step.move_to is None and plain.step.move_tool is None:
                continue
            ahead = lines_after(self.job.steps, number, touching)
            planned = await asyncio.to_thread(
                self._planner.plan, PlanRequest(plain, q, touching, ahead), self._others()
            )
            if not gate:
                verdict = await self._cell.dry_run(robot, planned.first)
                gate = f"{verdict.outcome}, {verdict.scale:.0%} of the first increment"
            q = planned.path[-1]
            self._motions.append(planned)
            near = planned.clearance
            outcome = StepOutcome(
                number + 1, plain.text, RunEnd.PLANNED, planned.duration_s, "", near.distance_m, near.pair
            )
            self.run.outcomes.append(outcome)
        self.run.end = RunEnd.PLANNED
        return self.report() | {"gate": gate}

    async def way(self) -> Way:
        """The whole path, planned as `rehearse` does; it raises the same."""
        gate, motions = (await self.rehearse())["gate"], self._motions
        seconds = sum(motion.duration_s for motion in motions)
        tightest = min((motion.clearance for motion in motions), key=lambda near: near.room_m)
        each = max(2, MOST_WAY_POINTS // len(motions))
        path = [q for motion in motions for q in points(motion.path, each)][:MOST_WAY_POINTS]
        return Way(
            rank=1,
            q=path[-1],
            points=tuple(path),
            clearance_m=tightest.distance_m,
            pair=tightest.pair,
            text=f"{seconds:.0f} s, at least {1000 * tightest.distance_m:.0f} mm between "
            f"{' and '.join(tightest.pair)}; the gate would now admit: {gate}",
        )

    def _seen(self, state: RobotState, view: View, rests: bool) -> SeenCycle:
        held = ""
        if state.phase is Phase.HELD:
            held = "held" if state.reason is None else f"{state.reason.value}: {EXPLANATIONS[state.reason]}"
        sight, camera = None, self.job.camera
        if camera is not None and (looking := self._cell.state(camera)) is not None:
            q = np.array(looking.q)
            sight = sight_of_equipment(self._model.robots[camera], q, looking.sight, looking.target)
        return SeenCycle(view, rests, held, sight)

    async def _carried_out(self, leased: LeasedRobot, request: RoutineRequest) -> RoutineAnswer:
        try:
            if isinstance(request, PlanRequest):
                return await asyncio.to_thread(self._planned, request)
            if isinstance(request, SwitchRequest):
                return dict((await leased.io(request.outputs)).inputs)
            if isinstance(request, AllowRequest):
                # noted first: the run may end before the answer comes
                self._allowed = request.contact
                await self._cell.allow_contact(request.contact, request.allowed)
                self._allowed = request.contact if request.allowed else ""
            elif isinstance(request, CoupleRequest):
                await self._change_tool(leased, request)
            elif self.job.camera is not None:
                wish = self._planner.view(request.at_equipment, self._others())
                await self._cell.view(self.job.camera, wish.distance_m, targets=wish.targets)
        except RoutineError as error:
            return error
        except DeltaqError as error:
            return RoutineError(str(error))
        return None

    async def _change_tool(self, leased: LeasedRobot, request: CoupleRequest) -> None:
        present, needs = self._coupled.get(leased.name), request.tool if request.action == "release" else ""
        if present != needs:
            has = "has no tool" if present == "" else f"has {present or 'an unknown tool'}"
            raise RoutineError(f"{leased.name} {has}, not {needs or 'a bare tool changer'}")
        await leased.couple(request.tool if request.action == "couple" else None)
        self._coupled = self._cell.description.coupled
        self._planner = await asyncio.to_thread(self._planner_now)

    def _planned(self, request: PlanRequest) -> PlannedMotion:
        planned = self._planner.plan(request, self._others())
        practise(planned.teleoperator)  # a first motion that compiles something would cost cycles
        return planned

    def done(self) -> dict[str, Any]:
        """The report of a run that is done.

        Raises:
            RoutineError: the run ended otherwise; the error has the report.
        """
        report = self.report()
        if self.run.end is not RunEnd.DONE:
            raise RoutineError(f"{self.job.routine}: {report['end']} at {self.run.why}", report)
        return report

    def report(self) -> dict[str, Any]:
        """The run as a JSON object."""
        job, run = self.job, self.run
        return {
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "cell": self._cell.description.cell,
            "routine": job.routine,
            "source": self._source,
            "equipment": job.equipment or None,
            "robot": job.robot,
            "numbers": job.numbers,
            "end": None if run.end is None else run.end.value,
            "why": run.why or None,
            "place": run.place,
            "steps": len(job.steps),
            "outcomes": [outcome.as_dict() for outcome in run.outcomes],
        }

    def _record(self) -> None:
        cell = self._cell.description.cell
        file = record_file(cell)
        with suppress(OSError):  # a robot that has moved is no worse for a full disk
            file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            kept = [*runs_of(cell)[1 - MOST_LINES :], self.report()]
            whole = file.with_suffix(f".{os.getpid()}")
            whole.write_text("".join(json.dumps(run) + "\n" for run in kept), encoding="utf-8")
            whole.replace(file)  # who reads it meanwhile has the old one, or the new one


def _check_tool(job: Job, coupled: Mapping[str, str | None]) -> None:
    """Check that a robot has the tool with which the equipment is worked on.

    Raises:
        RoutineError: it has another, or none.
    """
    if job.item is None or job.item.tool is None or job.item.kind == "tool_stand":
        return
    if (present := coupled.get(job.robot)) != job.item.tool:
        raise RoutineError(
            f"{job.equipment} needs {job.item.tool}, and {job.robot} has {present or 'none'}: fetch it first, with "
            "`deltaq routine run fetch_tool` and its stand"
        )


def record_file(cell: str) -> Path:
    """Where the runs of a cell's routines are kept, a JSON object a line."""
    given = os.environ.get("XDG_STATE_HOME")
    folder = Path(given) if given else Path.home() / ".local" / "state"
    return folder / "deltaq" / f"routines-{cell}.jsonl"


def runs_of(cell: str) -> list[dict[str, Any]]:
    """The recorded runs of a cell, the oldest first; lines that are no run are left out."""
    try:
        lines = record_file(cell).read_bytes().splitlines()
    except OSError:
        return []
    runs = []
    for line in lines:
        with suppress(ValueError):
            run = json.loads(line)
            if isinstance(run, dict) and run.keys() >= _RUN_FIELDS:
                runs.append(run)
    return runs


def unfinished(cell: str, robot: str = "") -> dict[str, Any]:
    """The last run of a cell, or of a robot of it, if it can be taken up.

    Raises:
        RoutineError: there is none.
    """
    runs = [run for run in runs_of(cell) if robot in ("", run["robot"])]
    if not runs:
        raise RoutineError(f"no routine has been run in cell {cell}{f' by {robot}' if robot else ''}")
    last = runs[-1]
    if not last["place"] < last["steps"]:
        what = f"{last['routine']} {last['equipment'] or ''}".strip()
        raise RoutineError(f"nothing to resume: the last run, {what}, ended: {last['end']}")
    return last
