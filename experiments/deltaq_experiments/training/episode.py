"""One episode: the stack in virtual time, the leader that moves in it, and what a policy sees of both robots."""

from __future__ import annotations

from collections import deque

from deltaq_controllers.interface import LastIncrement, RobotView, View
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_controllers.limits import IncrementLimits
from deltaq_experiments.scene import scene_of
from deltaq_experiments.training.observation import RobotObservation, RobotObserver
from deltaq_experiments.training.task import CameraTask, ViewErrors
from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import Phase, Verdict
from deltaq_testing.virtual_cell.cell import VirtualCell

Observation = dict[str, RobotObservation]
"""What is seen of the policy's `own` robot and of the `leader`."""


class Episode:
    """A run of the whole stack, one cycle a step.

    Args:
        stack: a new cell.
        leader: moves the leader.
        delay_cycles: how much older what is seen of the leader is.

    Attributes:
        stack: the cell.
        cycles: so far.
        observation: what the policy sees now.
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
        """Ask the gate for a share (n,) of the largest increment, and go on to the next cycle.

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
