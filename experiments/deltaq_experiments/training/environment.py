"""The environment: each step is one cycle of the whole stack, the gate in the loop."""

import math
from collections import deque
from pathlib import Path
from typing import Any, NamedTuple, cast

import gymnasium
import numpy as np
from gymnasium import spaces

from deltaq_controllers.camera.error import view_angle
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import LastIncrement, RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_controllers.limits import IncrementLimits
from deltaq_experiments.scene import VIEW_DISTANCE_M, link_cycles, scene_of, start_with_error
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Phase, Verdict
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

RobotObservation = dict[str, Array]
"""`q`, `q_cmd` and `dq` of a robot, (n,) each [rad or m]."""

BEYOND_CYCLES = 3.0
"""How far beyond a limit a robot may come while it lags behind its setpoints, in cycles at full speed."""
ROUNDED_UP = 1.01
"""Telegrams round setpoints, so that the largest increment may seem a little larger."""


class RobotObserver:
    """Follows one robot.

    Args:
        limits: of its increments.
    """

    def __init__(self, limits: IncrementLimits) -> None:
        self._last = LastIncrement(limits.max_ddq)

    def observe(self, view: RobotView) -> RobotObservation:
        """The present observation of the robot."""
        return {"q": view.q, "q_cmd": view.q_cmd, "dq": self._last.update(view)}


def robot_space(limits: IncrementLimits) -> spaces.Dict[Array]:
    """What observations of a robot are in."""
    beyond, largest = BEYOND_CYCLES * limits.max_dq, ROUNDED_UP * limits.max_dq
    position = spaces.Box(limits.lower - beyond, limits.upper + beyond, dtype=np.float64)
    increment = spaces.Box(-largest, largest, dtype=np.float64)
    return spaces.Dict({"q": position, "q_cmd": position, "dq": increment})


class ViewErrors(NamedTuple):
    """Errors of a view.

    Attributes:
        angle_rad: between the camera's axis and the direction of the focus [rad].
        distance_m: view distance less the desired one [m].
    """

    angle_rad: float
    distance_m: float

    @property
    def reward(self) -> float:
        """Zero for a perfect view, else negative: a radian counts as much as a metre."""
        return -self.angle_rad - abs(self.distance_m)


class CameraTask:
    """Measures views as the experiments do.

    Args:
        scene: the roles of the robots.

    Attributes:
        desired_distance_m: desired view distance [m].
    """

    desired_distance_m = VIEW_DISTANCE_M

    def __init__(self, scene: Scene) -> None:
        self._robot, self._leader = scene.robot, scene.leader
        self._aim = np.array([*scene.aim_offset_m, 1.0])

    def errors(self, q: Array, q_leader: Array) -> ViewErrors:
        """The errors at measured configurations (n,) of both robots [rad or m]."""
        T_world_camera = self._robot.camera_pose(q)
        lens, focus = T_world_camera[:3, 3], (self._leader.forward(q_leader) @ self._aim)[:3]
        distance_m = float(np.linalg.norm(focus - lens))
        return ViewErrors(
            view_angle(T_world_camera[:3, :3], lens, focus), distance_m - self.desired_distance_m
        )


Observation = dict[str, RobotObservation]
"""Observations of the policy's `own` robot and of the `leader`."""


class Episode:
    """A run of the whole stack, one cycle a step.

    Args:
        stack: a new cell.
        leader: moves the leader.
        delay_cycles: delay of the leader's states.

    Attributes:
        stack: the cell.
        cycles: number of cycles so far.
        observation: the present observation.
    """

    def __init__(self, stack: VirtualCell, leader: ScriptedLeader, delay_cycles: int) -> None:
        self.stack, self.cycles = stack, 0
        self._leader, self._scene = leader, scene_of(stack.cell)
        own, other = (
            IncrementLimits.of(robot, self._scene.cycle_s)
            for robot in (self._scene.robot, self._scene.leader)
        )
        self._limits = own
        self._own, self._other = RobotObserver(own), RobotObserver(other)
        self._last = LastIncrement(self._limits.max_ddq)
        self._task = CameraTask(self._scene)
        self._seen: deque[RobotView] = deque(maxlen=delay_cycles + 1)
        stack.run_until_ready()
        stack.acquire(self._scene.robot_name, "policy")
        stack.acquire(self._scene.leader_name, "scripted-leader")
        stack.cycle()  # a controller answers states that come after its lease
        self.observation = self._look()

    @property
    def errors(self) -> ViewErrors:
        """Of the view that the robots have now, not of the one that is seen late."""
        q, q_leader = (self._view(name).q for name in (self._scene.robot_name, self._scene.leader_name))
        return self._task.errors(q, q_leader)

    @property
    def is_lost(self) -> bool:
        """Whether only a reset makes the follower move again."""
        return self.stack.states[self._scene.robot_name].phase in (Phase.OFFLINE, Phase.HELD)

    def step(self, share: Array) -> tuple[Array, Verdict | None]:
        """Request a fraction (n,) of the largest increment, and advance by one cycle.

        Returns:
            The increment (n,) that was asked for [rad or m], and the gate's verdict on it.
        """
        robot, leader = self._scene.robot_name, self._scene.leader_name
        own, other = self._view(robot), self._view(leader)
        dq_last = self._last.update(own)
        dq = self._limits.admissible(share * self._limits.max_dq, own.q_cmd, dq_last)
        self.stack.ask(leader, self._leader.increment(View(other, {robot: own})))
        verdict = self.stack.ask(robot, dq)
        self.stack.cycle()
        self.cycles += 1
        self.observation = self._look()
        return dq, verdict

    def _view(self, robot: str) -> RobotView:
        return RobotView.from_state(self.stack.states[robot])

    def _look(self) -> Observation:
        self._seen.append(self._view(self._scene.leader_name))
        return {
            "own": self._own.observe(self._view(self._scene.robot_name)),
            "leader": self._other.observe(self._seen[0]),
        }


LARGEST_START_ERROR_DEG = 150.0
_SEEDS = 2**31


class CameraEnvironment(gymnasium.Env[Observation, Array]):
    """The paper's camera tracking: keep a moving tool in view, from the desired distance.

    An observation is what a controller sees: of its `own` robot and of the `leader` the configuration `q`, the
    setpoint `q_cmd` and the increment `dq` that led there, each (n,) [rad or m]. The leader's values are delayed by
    the link. An action (n,) in [-1, 1] is an increment, as a share of the largest one. It is clipped to the limits
    of speed, acceleration and braking distance, as in the shipped controllers; the gate alone checks distances. The
    reward is `-angle_rad - |distance_m|`, the errors of the view after the step.

    `info` has these errors, and after a step `dq`, the requested increment, and `verdict`, the fields of the gate's
    verdict that are not null.

    An episode is truncated when its time is over, and terminates when the robot is held. A seed determines the
    follower's start and the leader's motion; with the same actions the run is the same, bit for bit.

    Args:
        cell: name or file of a cell in which a robot with a camera can watch the tool of another one.
        leader_speed_m_s: largest speed of the leader's tool [m/s].
        latency_s: delay of the leader's states on the link, added to the drives' lag and the loop's cycles [s].
        duration_s: length of an episode [s].
        start_error_deg: largest view angle error at the start; it is at least half of that [deg].

    Raises:
        DeltaqError: the cell has no such robots, or a value is out of its bounds.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        cell: str | Path = "lab",
        leader_speed_m_s: float = 0.25,
        latency_s: float = 0.0,
        duration_s: float = 10.0,
        start_error_deg: float = 60.0,
    ) -> None:
        if not 0.0 < duration_s < math.inf:
            raise DeltaqError(f"duration_s must be a finite time above 0 s, got {duration_s}")
        if not 0.0 < start_error_deg <= LARGEST_START_ERROR_DEG:
            raise DeltaqError(
                f"start_error_deg must be above 0 and at most {LARGEST_START_ERROR_DEG:g}, got {start_error_deg}"
            )
        self._loaded = LoadedCell.load(cell)
        self._scene = scene_of(self._loaded.model)
        cycle_s = self._scene.cycle_s
        self._cycles = max(1, round(duration_s / cycle_s))
        self._delay_cycles = link_cycles(self._scene, latency_s)
        self._start_error_deg, self._leader_speed_m_s = start_error_deg, leader_speed_m_s
        self._leader(seed=0)  # refuses a wrong speed now rather than at the first reset
        self._episode: Episode | None = None
        own, leader = (
            IncrementLimits.of(robot, cycle_s) for robot in (self._scene.robot, self._scene.leader)
        )
        self.action_space = spaces.Box(-1.0, 1.0, own.max_dq.shape, dtype=np.float64)
        both = spaces.Dict({"own": robot_space(own), "leader": robot_space(leader)})
        # Gymnasium types a Dict by the spaces in it, and not by their elements
        self.observation_space = cast(spaces.Space[Observation], both)

    @property
    def episode(self) -> Episode:
        """The episode that runs.

        Raises:
            DeltaqError: before the first reset.
        """
        if self._episode is None:
            raise DeltaqError("no episode is running: call reset() first")
        return self._episode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of this episode and later ones; None continues the previous sequence.
            options: `start`, the configuration (n,) from which the follower begins in place of a random one [rad].
        """
        super().reset(seed=seed)
        start_seed, leader_seed = (int(self.np_random.integers(_SEEDS)) for _ in range(2))
        error_deg = self._start_error_deg * float(self.np_random.uniform(0.5, 1.0))
        start = self._given(options or {})
        if start is None:
            start = start_with_error(
                self._scene, CameraTask(self._scene), math.radians(error_deg), start_seed
            )
        stack = VirtualCell(self._loaded, {self._scene.robot_name: start})
        self._episode = Episode(stack, self._leader(leader_seed), self._delay_cycles)
        return self._episode.observation, self._episode.errors._asdict()

    def step(self, action: Array) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Request an increment, and advance by one cycle.

        Raises:
            DeltaqError: the action has another shape or is not finite, or no episode has begun.
        """
        share = np.asarray(action, dtype=np.float64)
        if share.shape != self.action_space.shape or not np.isfinite(share).all():
            raise DeltaqError(f"action: {self.action_space.shape} finite numbers are expected, got {action}")
        episode = self.episode
        dq, verdict = episode.step(share)
        errors = episode.errors
        info = {**errors._asdict(), "dq": dq, "verdict": _fields(verdict)}
        return episode.observation, errors.reward, episode.is_lost, episode.cycles >= self._cycles, info

    def _leader(self, seed: int) -> ScriptedLeader:
        return ScriptedLeader(self._scene.leader, self._scene.cycle_s, self._leader_speed_m_s, seed)

    def _given(self, options: dict[str, Any]) -> Array | None:
        if unknown := set(options) - {"start"}:
            raise DeltaqError(f"options: {', '.join(sorted(unknown))} is not an option; only start is")
        if "start" not in options:
            return None
        robot = self._scene.robot
        start = np.asarray(options["start"], dtype=np.float64)
        if start.shape != robot.home.shape or not ((robot.lower <= start) & (start <= robot.upper)).all():
            raise DeltaqError(
                f"options: start must be {robot.n} angles between {robot.lower} and {robot.upper} [rad], got {start}"
            )
        return start


def _fields(verdict: Verdict | None) -> dict[str, Any]:
    """What a verdict has; a vector of environments cannot put None among numbers."""
    return {} if verdict is None else verdict.model_dump(mode="json", exclude_none=True)
