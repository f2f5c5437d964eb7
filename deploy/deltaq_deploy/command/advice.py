"""The advisor on a cell: from where its robot is, or from its home, and through the gate to an option."""

import asyncio
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import CellDescription, Pose
from deltaq_cell.robot_bodies import placement
from deltaq_controllers.advisor.advisor import Option, Progress
from deltaq_controllers.advisor.advisor import advise as advise_on
from deltaq_controllers.advisor.exact import ExactClearance
from deltaq_controllers.advisor.problem import AdvisorError, AdvisorProblem
from deltaq_controllers.advisor.session import Answered
from deltaq_controllers.inverse.tracking import ConstraintTracker, first_redundant
from deltaq_controllers.live import ControlStatistics, cell_model
from deltaq_controllers.modes.advisor import AdvisorMode
from deltaq_controllers.modes.teleoperator import Teleoperator
from deltaq_controllers.operator_input.script import GoToOption
from deltaq_controllers.task import NO_TASK, Task
from deltaq_controllers.teleoperation import teleoperate
from deltaq_deploy.launch.cell_connection import Where, connect, describe, known_robot
from deltaq_protocol import connect as connect_to
from deltaq_protocol.arrays import Array
from deltaq_protocol.blocking import BlockingCell
from deltaq_protocol.driving import DrivingMode

STATE_DEADLINE_S = 5.0


@dataclass(frozen=True)
class AdviceRequest:
    """A question to the advisor; see `deltaq advise`."""

    cell: str
    url: str | None = None
    robot: str = ""
    hands: Mapping[str, tuple[float, ...]] | None = None
    options: int = 5
    method: str = "annealing"
    task: Task = NO_TASK
    effort: float = 1.0
    seed: int = 0
    offline: bool = False
    execute: int = 0
    trade_off: tuple[str, str] | None = None
    hands_may_leave: bool = False


@dataclass(frozen=True)
class Driven:
    """How an option was driven to.

    Attributes:
        option: its rank.
        reached: whether the robot stands there; otherwise it was stopped on its path.
        outcomes: how many increments had which outcome.
        hands_off_m: distance of the hands from their given poses, at the end.
    """

    option: int
    reached: bool
    outcomes: dict[str, int]
    hands_off_m: float


@dataclass(frozen=True)
class Advice:
    """The advisor's answer.

    Attributes:
        cell: name of the cell.
        robot: name of the robot.
        joints: their names.
        method: of the search.
        seed: of the search.
        task: title of the task; empty without one.
        weights: of the criteria.
        hands: (4, 4) pose required of each hand, in the world.
        options: best first.
        trials: configurations tried.
        elapsed_s: from the question to the options, paths included.
        executed: how the requested option was driven to; None if none was.
        trade_off: the two criteria whose front the options are of; None for the least energy.
        word: on an arm without a closed form; empty if every arm has one.
    """

    cell: str
    robot: str
    joints: tuple[str, ...]
    method: str
    seed: int
    task: str
    weights: dict[str, float]
    hands: dict[str, Array]
    options: list[Option]
    trials: int
    elapsed_s: float
    executed: Driven | None = None
    trade_off: tuple[str, str] | None = None
    word: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The answer as a JSON object, in SI units."""
        return vars(self) | {
            "task": self.task or None,
            "hands": {name: pose.tolist() for name, pose in self.hands.items()},
            "word": self.word or None,
            "options": [_as_dict(rank, option) for rank, option in enumerate(self.options, start=1)],
            "executed": None if self.executed is None else asdict(self.executed),
        }


def advice(request: AdviceRequest, go_on: Callable[[Progress], bool] = lambda _: True) -> Advice:
    """Ask the advisor, and drive to an option if requested.

    Raises:
        AdvisorError: a task that it cannot work on, or an option that does not exist or has no path.
        TaskError: the cell or the robot does not have what the task names, or a hand is not in its region.
        ServiceUnreachableError: the cell is not running, and `offline` was not given.
        RefusedError: another client holds the robot's lease.
    """
    cell = CellModel.load(request.cell) if request.url is None else _running_model(request.url)
    known_robot(cell.description, request.robot)
    seen = request.task.seen(cell)
    robot, tracker = _robot(cell, request.robot or request.task.robot, request.task)
    with ExitStack() as stack:
        running: BlockingCell | None = None
        present = {name: np.array(model.home) for name, model in cell.robots.items()}
        if not request.offline:
            running = stack.enter_context(connect(cell.description, "deltaq advise"))
            present |= _present(running)
        poses = _poses(tracker, present[robot], request.hands or {})
        # an arm without a joint to spare has options where its hand is to go elsewhere
        may_leave = request.hands_may_leave or (bool(request.hands) and not len(tracker.base))
        problem = AdvisorProblem(seen, robot, poses, None, tracker, present, may_leave)
        began_s = time.perf_counter()
        options = advise_on(
            problem,
            present[robot],
            generator=np.random.default_rng(request.seed),
            options=request.options,
            method=request.method,
            effort=request.effort,
            trade_off=request.trade_off,
            exact=ExactClearance(seen, robot, present),
            go_on=go_on,
        )
        elapsed_s = time.perf_counter() - began_s
        executed = None
        if request.execute:
            assert running is not None  # the command refuses to execute offline
            executed = _drive(cell.description, tracker, options, request.execute)
        return Advice(
            cell=cell.description.cell,
            robot=robot,
            joints=tracker.own.joint_names,
            method=request.method,
            seed=request.seed,
            task=request.task.title,
            weights=problem.weights,
            hands=dict(zip(tracker.robot.hands, poses, strict=True)),
            options=options,
            trials=problem.count,
            elapsed_s=elapsed_s,
            executed=executed,
            trade_off=request.trade_off,
            word=tracker.word,
        )


def _running_model(url: str) -> CellModel:
    """The model of the cell that runs at an address, from its HLI's description."""
    where = Where.of("", url)
    told = describe(where, "deltaq advise")
    model = cell_model(told)
    return CellModel.of(model.description.model_copy(update={"hli": where.hli}), model.robots, told.yaml)


def _robot(cell: CellModel, name: str, task: Task) -> tuple[str, ConstraintTracker]:
    """The robot of that name, or the first redundant one."""
    name = name or ("" if (tracker := first_redundant(cell.robots)) is None else tracker.robot.name)
    if name:
        return name, ConstraintTracker(cell.robots[name], task)
    raise AdvisorError(
        f"cell {cell.description.cell} has no redundant robot with at least six revolute joints before each hand: "
        "there is nothing to advise on"
    )


def _present(running: BlockingCell) -> dict[str, Array]:
    """Setpoints of the robots of a running cell, after the first state of each."""
    deadline_s = time.monotonic() + STATE_DEADLINE_S
    while True:
        status = running.status().robots
        if all(robot.q for robot in status.values()):
            states = {name: running.state(name) for name in status}
            return {
                name: np.array(robot.q if state is None else state.q_cmd)
                for (name, robot), state in zip(status.items(), states.values(), strict=True)
            }
        if time.monotonic() > deadline_s:
            silent = ", ".join(name for name, robot in status.items() if not robot.q)
            raise AdvisorError(f"no state of {silent} within {STATE_DEADLINE_S:g} s; see `deltaq status`")


def _poses(tracker: ConstraintTracker, present: Array, given: Mapping[str, tuple[float, ...]]) -> Array:
    """(h, 4, 4) poses required of the hands: as given, otherwise the present ones."""
    hands = tracker.robot.hands
    for name in given:
        if name not in hands:
            raise AdvisorError(
                f"robot '{tracker.robot.name}' has no hand {name!r}; it has {', '.join(hands)}"
            )
    poses = tracker.hands(present)
    for number, name in enumerate(hands):
        if name in given:
            x, y, z, roll, pitch, yaw = given[name]
            poses[number] = placement(Pose(position_m=(x, y, z), rpy_deg=(roll, pitch, yaw))).homogeneous
    return poses


def _drive(cell: CellDescription, tracker: ConstraintTracker, options: list[Option], rank: int) -> Driven:
    """Drive to the option of a rank, the robot at rest where the paths begin."""
    if rank > len(options):
        raise AdvisorError(f"there is no option {rank}; there are {len(options)}")
    option = options[rank - 1]
    if option.path is None:
        ways = [str(number) for number, other in enumerate(options, start=1) if other.path is not None]
        raise AdvisorError(
            f"no path is known to option {rank}: {option.no_path}; options with a path: {', '.join(ways) or 'none'}"
        )
    answered = Answered(tracker, Progress("finding paths", 1.0, options[0].energy, 0, tuple(options)))
    return asyncio.run(_go(cell, answered, rank, tracker.hands(option.q)))


async def _go(cell: CellDescription, answered: Answered, rank: int, T_world_hands: Array) -> Driven:
    robot = answered.tracker.own
    modes = {DrivingMode.ADVISOR: lambda robot: AdvisorMode(robot, cell.cycle_s, answered)}
    teleoperator = Teleoperator(robot, cell.cycle_s, DrivingMode.ADVISOR, modes=modes)
    statistics, enough = ControlStatistics(), asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGINT, enough.set)
    async with connect_to(cell.hli, client="deltaq advise") as running:
        operator = GoToOption(teleoperator, rank)
        await teleoperate(running, teleoperator, operator, statistics, lambda _: None, enough)
        state = running.state(robot.name)
    assert state is not None  # the robot has been driven
    off = answered.tracker.hands(np.array(state.q_cmd)) - T_world_hands
    return Driven(
        option=rank,
        reached=operator.reached,
        outcomes=statistics.summary()["gate"],
        hands_off_m=float(np.linalg.norm(off[:, :3, 3], axis=1).max()),
    )


def _as_dict(rank: int, option: Option) -> dict[str, Any]:
    return {
        "rank": rank,
        "energy": option.energy,
        "energy_here": option.energy_here,
        "q": option.q.tolist(),
        "values": option.values,
        "costs": option.costs,
        "clearance_m": option.clearance.distance_m,
        "room_m": option.clearance.room_m,
        "pair": list(option.clearance.pair),
        "nearest_limit": option.nearest_limit,
        "limit_share": option.limit_share,
        "near": {
            kind.name.lower(): {"distance_m": one.distance_m, "room_m": one.room_m, "pair": list(one.pair)}
            for kind, one in option.nearest.items()
        },
        "hands_move": option.hands_move,
        "hands_leave": option.hands_leave,
        "path": None if option.path is None else option.path.tolist(),
        "no_path": option.no_path or None,
    }
