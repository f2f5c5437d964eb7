"""The gate by itself: any arm with a URDF, in one process and without a cell.

    from deltaq import Box, Gate

    gate = Gate.from_urdf("panda.urdf", cycle_s=0.004, obstacles={"table": Box((1.2, 0.8, 0.05), at=(0.5, 0, -0.03))})
    step = gate.step(dq)         # (n,) increment that may be sent now, and why
    gate.would_admit(q_cmd, dq)  # the same question without an effect

The decisions are those of the SIM's own core (`deltaq_services.sim.core`): the same reasons, bounds and receipts.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from deltaq.foreign_robot import described, in_convex_parts
from deltaq.obstacles import GateError, Mesh, Obstacle, numbers, positive
from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import CellDescription, GateDescription
from deltaq_cell.hull import hull_shape
from deltaq_cell.never_checked import distances, ordered, samples
from deltaq_cell.robot import RobotModel
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Admission, Request, ServerState, Supervision
from deltaq_protocol.messages import NearestPair, Outcome, Phase, Reason, Verdict
from deltaq_protocol.messages.base import MOST_OF_A_JOINT
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.outputs import ToTopic
from deltaq_services.sim.core import Sim
from deltaq_services.sim.gate import verdict_of
from deltaq_services.sim.gated_robot import GatedRobot
from deltaq_services.sim.tracker import Tracker

ARM = "arm"
"""Name of the robot of `Gate.from_urdf`."""

_EPOCH = 1
_NAME = re.compile(r"[a-z][a-z0-9_-]{0,62}")
_SPAN_S = 60.0
"""Longest time between two steps that is taken for a pause [s]."""


@dataclass(frozen=True)
class Step:
    """What may be done in one cycle.

    Attributes:
        dq: (n,) increment to send now: the request, a part of it, or the next step of the stopping trajectory
            [rad or m].
        q_cmd: (n,) setpoint after it [rad or m].
        verdict: as the SIM publishes it, with scale, clearance, time to stop and receipt.
    """

    dq: Array
    q_cmd: Array
    verdict: Verdict

    @property
    def outcome(self) -> Outcome:
        """Admitted, scaled, held, or refused."""
        return self.verdict.outcome

    @property
    def admitted(self) -> bool:
        """Whether the whole request was admitted."""
        return self.outcome is Outcome.ADMITTED

    @property
    def scale(self) -> float:
        """Share of the request in `dq`; the rest is the stopping trajectory. 0 if held or refused."""
        return self.verdict.scale or 0.0

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What limited the request, tightest first; empty if it was admitted."""
        return self.verdict.reasons

    @property
    def why(self) -> str:
        """The reasons in words, with value and bound; empty if the request was admitted."""
        return "; ".join(_words(reason) for reason in self.reasons)


@dataclass
class _Arm:
    """One robot: the motion that its Robot Server would send, and its measured configuration."""

    motion: SetpointMotion
    measured: Array | None = None
    stopped: Reason | None = None
    seq: int = 0


class Gate:
    """The gate for the robots of one cell; `from_urdf` and `from_cell` make one.

    Each `step` is one cycle. Whatever is asked for, the setpoints that `step` returns keep position, velocity and
    acceleration limits and the stop distances, and so does the stopping trajectory after them.

    Attributes:
        cell: the model: robots, bodies and margins.
        sources: source of each limit, by `joint.limit`; empty for a described cell.
    """

    def __init__(
        self,
        cell: CellModel,
        obstacles: Mapping[str, Obstacle] | None = None,
        q: Mapping[str, ArrayLike] | None = None,
        sources: Mapping[str, str] | None = None,
        tools: Mapping[str, str] | None = None,
    ) -> None:
        if obstacles is not None and not isinstance(obstacles, Mapping):
            kind = type(obstacles).__name__
            raise GateError("obstacles", kind, "must be a dict of bodies by name", "name each")
        gate = cell.description.gate.model_copy(update={"lookahead_cycles": 1})
        description = cell.description.model_copy(update={"gate": gate})
        self._bare = CellModel(description, cell.robots, cell.structure, cell.yaml)
        self.sources, self._tools = dict(sources or {}), dict(tools or {})
        for name, tool in self._tools.items():
            known = cell.description.robots[name].tools if name in cell.robots else ()
            if tool not in known:
                bound = f"must be one of {', '.join(known) or 'none'}"
                raise GateError(f"tools.{name}", tool, bound, "name a tool of a robot with a tool changer")
        self._obstacles: dict[str, Obstacle] = {}
        self._time_s: float | None = None
        self._cycle = 0
        self._arms: dict[str, _Arm] = {}
        self._identity = ""
        self.cell, self._sim = self._with(dict(obstacles or {}))
        self._obstacles = dict(obstacles or {})
        self._at_start = self._sim.snapshot()
        self._identity = self._at_start.cell
        self.reset({name: robot.home for name, robot in cell.robots.items()} | dict(q or {}))

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        cycle_s: float,
        obstacles: Mapping[str, Obstacle] | None = None,
        q: ArrayLike | None = None,
        *,
        srdf: str | Path | None = None,
        joint_limits: str | Path | None = None,
        locked: Mapping[str, float] | None = None,
        stop_distance_m: float = 0.02,
        self_stop_distance_m: float = 0.005,
        lag_s: float | None = None,
        tolerance: float = 1e-4,
    ) -> Gate:
        """A gate for one arm.

        Args:
            urdf: file, name of a shipped model, or `package://` and a path within a package.
            cycle_s: time between two steps [s], 0.001 to 0.1.
            obstacles: by name; see `place`.
            q: (n,) start; by default zero, or the middle of a joint's limits if zero is outside [rad or m].
            srdf: file with the pairs of links that are never checked, besides those that always touch.
            joint_limits: MoveIt's `joint_limits.yaml`; by default that beside the SRDF, if any. It may narrow the
                URDF's limits. An acceleration that no file gives is velocity / 0.4 s.
            locked: joints that do not move, such as fingers, and where they are [rad or m].
            stop_distance_m: least distance of the arm from obstacles [m].
            self_stop_distance_m: least distance between two links [m].
            lag_s: how long the drives may still travel a setpoint after it was sent; by default one cycle [s].
            tolerance: permitted deviation of a joint from its setpoints of that time [rad or m].

        Raises:
            GateError: a parameter, a limit or an obstacle cannot be; it has field, value, bound and remedy.
            RobotModelError: the URDF or a mesh cannot be read, or its bodies are no robot's.
        """
        cycle = positive("cycle_s", cycle_s, 0.1, "give the robot's sample time in s")
        if cycle < 0.001:
            raise GateError("cycle_s", cycle_s, "must be at least 0.001", "give the robot's sample time in s")
        remedy = "give a small distance in m, such as 0.01"
        margins = GateDescription(
            stop_distance_m=positive("stop_distance_m", stop_distance_m, 1.0, remedy),
            self_stop_distance_m=positive("self_stop_distance_m", self_stop_distance_m, 1.0, remedy),
            servo_lag_s=positive("lag_s", cycle if lag_s is None else lag_s, 2.0, "give it in s"),
            servo_lag_spread_s=0.0,
        )
        width = positive("tolerance", tolerance, 1.0, "give the drives' accuracy, such as 0.001")
        robot, sources = described(urdf, srdf, joint_limits, locked or {}, q, width)
        model = RobotModel(robot, ARM, *in_convex_parts(urdf, locked or {}))
        _check_self(model, margins.self_stop_distance_m)
        description = CellDescription(cell="gate", cycle_s=cycle, robots={ARM: robot}, gate=margins)
        return cls(CellModel.of(description, {ARM: model}), obstacles, None, sources)

    @classmethod
    def from_cell(
        cls,
        cell: str | Path,
        obstacles: Mapping[str, Obstacle] | None = None,
        q: Mapping[str, ArrayLike] | None = None,
        tools: Mapping[str, str] | None = None,
    ) -> Gate:
        """A gate for all robots of a described cell.

        Args:
            cell: name or file; structure, margins and limits are the cell's.
            obstacles: beside its structure.
            q: start configurations by robot, each (n,) [rad or m]; robots without one start at home.
            tools: the tool at each tool changer, by robot; a changer that is not named is bare.

        Raises:
            CellError: there is no such cell, or its file has errors.
            GateError: an obstacle, a start or a tool cannot be.
        """
        return cls(CellModel.load(cell), obstacles, q, tools=tools)

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the robots."""
        return tuple(self.cell.robots)

    @property
    def obstacles(self) -> dict[str, Obstacle]:
        """The obstacles now, without a cell's own structure."""
        return dict(self._obstacles)

    def q_cmd(self, robot: str | None = None) -> Array:
        """(n,) present setpoint [rad or m]; of several robots `robot` says whose."""
        return self._arms[self._named(robot)].motion.q_cmd.copy()

    @overload
    def step(self, dq: Mapping[str, ArrayLike], time_s: float | None = None) -> dict[str, Step]: ...

    @overload
    def step(self, dq: ArrayLike, time_s: float | None = None) -> Step: ...

    def step(
        self, dq: ArrayLike | Mapping[str, ArrayLike], time_s: float | None = None
    ) -> Step | dict[str, Step]:
        """Decide one cycle.

        Args:
            dq: (n,) increment asked for [rad or m]; of several robots by name, and the others brake.
            time_s: when it is sent, on a clock of the caller's [s]; in cycles that were left out the robots braked.

        Returns:
            What to send now, of each robot that was asked for.

        Raises:
            GateError: an increment has another length or is not finite, or the time is before the last; nothing moves.
        """
        asked = dq if isinstance(dq, Mapping) else {self._named(None): dq}
        wanted = {self._named(name): self._increment(self._named(name), each) for name, each in asked.items()}
        for _ in range(self._passed(time_s)):
            self._go({})
        steps = self._go(wanted)
        return steps if isinstance(dq, Mapping) else next(iter(steps.values()))

    def would_admit(self, q_cmd: ArrayLike | None, dq: ArrayLike, robot: str | None = None) -> Step:
        """Decide an increment without an effect.

        Args:
            q_cmd: (n,) setpoint where the robot rests; None for its present motion [rad or m].
            dq: (n,) increment asked for [rad or m].
            robot: its name, if there are several; the others keep their motion.
        """
        name = self._named(robot)
        increment = self._increment(name, dq)
        tracker = self._known(name)
        if q_cmd is None:
            self._feed(tracker, self._state(name))
        else:
            rest = SetpointMotion.at_rest(self._position(name, "q_cmd", q_cmd))
            tracker = self._fresh(name).tracker
            for cycle in range(1, tracker.drives.lag + 3):
                self._feed(tracker, self._state(name, rest, cycle))
        others = [other.tracker for other in self._sim.robots.values() if other.name != name]
        violations = self._sim.violations.snapshot()
        try:
            decision = self._sim.gate.decide(tracker, others, increment)
        finally:
            self._sim.violations.restore(violations)
        cycle_s = self.cell.description.cycle_s
        verdict = verdict_of(name, self._cycle, self._cycle + 1, 0, decision, cycle_s)
        return Step(decision.dq, tracker.q_cmd + decision.dq, verdict)

    def observe(self, q: ArrayLike, robot: str | None = None) -> None:
        """Compare a measured configuration, (n,) [rad or m], with the certified path; the next step uses it.

        Off its setpoints of the last `lag_s` by more than the tolerance, the robot is stopped until `reset`.
        """
        name = self._named(robot)
        self._arms[name].measured = self._joints(name, "q", q)

    def reset(self, q: ArrayLike | Mapping[str, ArrayLike]) -> None:
        """Restart with robots at rest at `q`, (n,) or by name [rad or m]; unnamed robots stay where they are.

        Raises:
            GateError: `q` is outside the limits, or a body overlaps another there.
        """
        given = q if isinstance(q, Mapping) else {self._named(None): q}
        start = {
            self._named(name): self._position(self._named(name), "q", each) for name, each in given.items()
        }
        at = {name: start[name] if name in start else self.q_cmd(name) for name in self.robots}
        _check_clear(self._sim, at, "q", "start elsewhere, or correct the bodies")
        memory = self._at_start.model_copy(
            update={"receipt": self._sim.snapshot().receipt, "cell": self._identity}
        )
        self._sim.restore(memory)
        self._arms = {name: _Arm(SetpointMotion.at_rest(q)) for name, q in at.items()}
        self._cycle, self._time_s = 0, None
        for _ in range(2 + max(robot.tracker.drives.lag for robot in self._sim.robots.values())):
            self._go({})

    def place(self, name: str, obstacle: Obstacle) -> None:
        """Add an obstacle, or move or exchange that of this name; the next step goes by it.

        Where it comes nearer to a robot than the stop distance, the robot brakes, and then moves away only, slowly.

        Raises:
            GateError: it cannot be, or overlaps a robot; everything stays as it was.
        """
        self._change(self._obstacles | {name: obstacle}, name)

    def remove(self, name: str) -> None:
        """Remove an obstacle.

        Raises:
            GateError: there is none of that name.
        """
        if name not in self._obstacles:
            bound = f"must be one of {', '.join(self._obstacles) or 'none'}"
            raise GateError("name", name, bound, "name an obstacle that was placed")
        self._change({key: value for key, value in self._obstacles.items() if key != name}, name)

    def nearest(self) -> NearestPair | None:
        """The two nearest bodies now, with distance and witness points [m]; None if nothing is checked."""
        return self._sim.nearest()

    def _change(self, obstacles: dict[str, Obstacle], changed: str) -> None:
        cell, sim = self._with(obstacles)
        at = {name: arm.motion.q_cmd for name, arm in self._arms.items()}
        _check_clear(sim, at, f"obstacles.{changed}", "move the robot or the obstacle away first")
        memory, body = self._sim.snapshot(), f"structure/{changed}"
        identity = sim.snapshot().cell
        kept = tuple(each for each in memory.violations if body not in each.pair)
        sim.restore(memory.model_copy(update={"violations": kept, "cell": identity}))
        self.cell, self._sim, self._obstacles, self._identity = cell, sim, obstacles, identity

    def _with(self, obstacles: Mapping[str, Obstacle]) -> tuple[CellModel, Sim]:
        """The cell with some obstacles, and its core."""
        bodies, meshes, digest = {}, [], hashlib.sha256()
        for name, obstacle in obstacles.items():
            where = f"obstacles.{name}"
            if not isinstance(obstacle, Obstacle):
                kind = type(obstacle).__name__
                raise GateError(where, kind, "must be a Box, Sphere, Cylinder, Capsule or Mesh", "give one")
            if not _NAME.fullmatch(str(name)) or name in self._bare.description.structure:
                bound = "a name must be of a-z, 0-9, _ and -, and not the structure's"
                raise GateError("obstacles", name, bound, "rename it")
            obstacle.judge(where)
            if isinstance(obstacle, Mesh):
                place = pin.SE3(pin.rpy.rpyToMatrix(*obstacle.rpy), np.array(obstacle.at, dtype=np.float64))
                hull = hull_shape(obstacle.corners(where))
                meshes.append(pin.GeometryObject(f"structure/{name}", 0, place, hull))
                digest.update(name.encode() + obstacle.digest().encode())
            else:
                rpy_deg = tuple(math.degrees(angle) for angle in obstacle.rpy)
                pose = {"position_m": tuple(map(float, obstacle.at)), "rpy_deg": rpy_deg}
                bodies[name] = {"shape": obstacle.shape(), "pose": pose}
        description = self._bare.description
        told: dict[str, Any] = {name: body.model_dump() for name, body in description.structure.items()}
        # meshes are no part of a description; the name carries them into the fingerprint
        title = f"{description.cell[:40]}-{digest.hexdigest()[:16]}" if meshes else description.cell
        structure = CellDescription.model_validate(
            description.model_dump() | {"cell": title, "structure": told | bodies}
        )
        cell = CellModel.of(structure, self._bare.robots, self._bare.yaml)
        cell = CellModel(cell.description, cell.robots, (*cell.structure, *meshes), cell.yaml)
        return cell, Sim(cell, _EPOCH)

    def _go(self, wanted: Mapping[str, Array]) -> dict[str, Step]:
        """One cycle: states, requests or heartbeats, and what comes of them."""
        self._cycle += 1
        for name, arm in self._arms.items():
            for output in self._sim.take(self._state(name)):
                if isinstance(output.message, Supervision) and output.message.stop and arm.stopped is None:
                    arm.stopped = Reason(code=output.message.stop)
        verdicts: dict[str, Verdict] = {}
        admissions: dict[str, Admission] = {}
        for name, arm in self._arms.items():
            dq = wanted.get(name)
            arm.seq += 1
            request = Request(
                robot=name,
                cycle=self._cycle,
                lease_epoch=1,
                seq=arm.seq,
                dq=None if dq is None else tuple(dq.tolist()),
            )
            _sort(self._sim.take(request), verdicts, admissions)
        for name, arm in self._arms.items():
            taken = admissions.get(name)
            arm.motion = arm.motion.braked() if taken is None else arm.motion.admitted(taken)
            arm.measured = None
        return {name: self._step(name, verdicts[name]) for name in wanted}

    def _step(self, name: str, verdict: Verdict) -> Step:
        arm = self._arms[name]
        if arm.stopped is not None and verdict.outcome is Outcome.REFUSED:
            verdict = verdict.model_copy(update={"reasons": (arm.stopped, *verdict.reasons)})
        return Step(arm.motion.dq.copy(), arm.motion.q_cmd.copy(), verdict)

    def _state(
        self, name: str, motion: SetpointMotion | None = None, cycle: int | None = None
    ) -> ServerState:
        arm = self._arms[name]
        now = arm.motion if motion is None else motion
        measured = now.q_cmd if arm.measured is None or motion is not None else arm.measured
        held = arm.stopped if motion is None else None
        number = self._cycle if cycle is None else cycle
        changer, tool = self.cell.description.robots[name].tool_changer, self._tools.get(name, "")
        return ServerState(
            robot=name,
            process=1,
            cycle=number,
            ipoc=number,
            time_s=number * self.cell.description.cycle_s,
            q=tuple(measured.tolist()),
            q_cmd=tuple(now.q_cmd.tolist()),
            dq=tuple(now.dq.tolist()),
            plan=now.plan,
            epoch=_EPOCH,
            sequence=now.sequence,
            phase=Phase.HELD if held else Phase.READY if now.rests else Phase.ENGAGED,
            reason=None if held is None else held.code,
            cell=self._identity,
            inputs={changer.locked: bool(tool)} if changer else {},
            tool=tool if changer else None,
        )

    def _known(self, name: str) -> Tracker:
        """A copy of the core's tracker of a robot."""
        copy = self._fresh(name).tracker
        copy.restore(self._sim.robots[name].tracker.snapshot())
        return copy

    def _fresh(self, name: str) -> GatedRobot:
        cell = self.cell.description
        return GatedRobot(name, cell.robots[name], cell.gate, cell.cycle_s)

    def _feed(self, tracker: Tracker, state: ServerState) -> None:
        newest = tracker.state
        cycle = state.cycle if newest is None else newest.cycle + 1
        tracker.observe(state.model_copy(update={"cycle": cycle}))

    def _passed(self, time_s: float | None) -> int:
        """How many cycles were left out before a time."""
        if time_s is None:
            self._time_s = None
            return 0
        remedy = "give times that grow, such as time.monotonic(), and reset after a longer pause"
        time_s = float(numbers("time_s", [time_s], 1, remedy, math.inf)[0])
        before = 0.0 if self._time_s is None else self._time_s
        most = math.inf if self._time_s is None else _SPAN_S
        if not 0.0 <= time_s - before <= most:
            bound = "at least 0" if self._time_s is None else f"within {most:g} s after {before:g}"
            raise GateError("time_s", time_s, f"must be {bound}", remedy)
        passed = 1 if self._time_s is None else round((time_s - before) / self.cell.description.cycle_s)
        self._time_s = time_s
        return max(0, passed - 1)

    def _named(self, robot: str | None) -> str:
        if robot is None and len(self.robots) == 1:
            return self.robots[0]
        if robot not in self.cell.robots:
            raise GateError("robot", robot, f"must be one of {', '.join(self.robots)}", "name one")
        return robot

    def _joints(self, name: str, field: str, value: ArrayLike) -> Array:
        names = self.cell.robots[name].joint_names
        return numbers(field, value, len(names), f"give one for each of {', '.join(names)}", MOST_OF_A_JOINT)

    def _increment(self, name: str, dq: ArrayLike) -> Array:
        return self._joints(name, "dq", dq)

    def _position(self, name: str, field: str, value: ArrayLike) -> Array:
        q, robot = self._joints(name, field, value), self.cell.robots[name]
        out = np.maximum(robot.lower - q, q - robot.upper)
        if out.max() > 1e-9:
            joint = int(out.argmax())
            low, high = robot.lower[joint], robot.upper[joint]
            bound = f"{robot.joint_names[joint]} must be within its limits, {low:.6g} to {high:.6g}"
            raise GateError(field, float(q[joint]), bound, "give another configuration")
        return np.clip(q, robot.lower, robot.upper)


def _sort(outputs: list[ToTopic], verdicts: dict[str, Verdict], admissions: dict[str, Admission]) -> None:
    for output in outputs:
        message = output.message
        if isinstance(message, Verdict):
            verdicts[message.robot] = message
        elif isinstance(message, Admission):
            admissions[message.robot] = message


def _check_clear(sim: Sim, q: Mapping[str, Array], field: str, remedy: str) -> None:
    """Raise a `GateError` if two checked bodies overlap with the robots at `q`, each (n,) [rad or m]."""
    near = sim.nearest_at(q)
    if near is not None and near.distance_m <= 0.0:
        bound = f"{' and '.join(near.pair)} must not overlap"
        raise GateError(field, f"{near.distance_m:.4f} m", bound, remedy)


def _check_self(model: RobotModel, stop_m: float) -> None:
    """Raise a `GateError` if two links that are checked are never as far apart as the stop distance."""
    bodies = list(model.geometry.geometryObjects)
    names = [body.name for body in bodies]
    left_out = model.never_checked_pairs()
    pairs = [
        ordered(one, other)
        for index, one in enumerate(names)
        for other in names[index + 1 :]
        if ordered(one, other) not in left_out
    ]
    drawn = samples(model.lower, model.upper)
    for count in (20, len(drawn)):  # a few samples part most pairs
        if pairs:
            farthest = distances(model.model, bodies, pairs, drawn[:count]).max(axis=0)
            pairs = [pair for pair, most in zip(pairs, farthest, strict=True) if most <= stop_m]
    if pairs:
        most = float(distances(model.model, bodies, pairs[:1], drawn).max())
        bound = f"{' and '.join(pairs[0])} are never farther apart than {most:.4f} m"
        raise GateError("self_stop_distance_m", stop_m, bound, "lower it, or leave the pair out by an SRDF")


def _words(reason: Reason) -> str:
    text = f"{reason.code.value} {reason.what}".strip()
    return text if reason.value is None else f"{text}: {reason.value:.4g}, bound {reason.bound:.4g}"
