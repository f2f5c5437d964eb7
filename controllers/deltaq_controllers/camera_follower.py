"""The camera follower as a process: `python -m deltaq_controllers.camera_follower --url tcp/127.0.0.1:7447`."""

import argparse
import asyncio
import contextlib
import logging
import math
import time
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from deltaq_cell.roles import camera_roles
from deltaq_controllers.camera import FOLLOWS
from deltaq_controllers.camera.controllers import NAMES, FocusController, camera_controller_named
from deltaq_controllers.camera.in_use import CameraInUse
from deltaq_controllers.camera.outlook import Outlook
from deltaq_controllers.camera.scene import Scene
from deltaq_controllers.interface import ControllerError, HeldBack, LastIncrement, RobotView, View
from deltaq_controllers.limits import IncrementLimits
from deltaq_controllers.live import (
    ControlStatistics,
    ErrorStatistics,
    ToolChangedError,
    cell_model,
    drive,
    run,
)
from deltaq_controllers.robot_clocks import ClockReading
from deltaq_protocol import connect
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import DEFAULT_ADDRESS
from deltaq_protocol.messages import Sight, ViewTarget
from deltaq_protocol.messages.motion import AIM_M

# What an experiment adds to a camera controller: a start configuration, and a sequence of view distances.
#
# Time is the stamp of the states, so that the same views give the same increments, live and in virtual
# time.

SPEED_SHARE, BRAKE_SHARE = 0.2, 0.3
"""Fractions of the joints' speeds and accelerations that the motion to the start uses."""

ARRIVED = 1e-4
"""Largest distance of a joint's setpoint from the start, and largest motion of setpoint and joint in a cycle, at which
the start counts as reached [rad or m]."""


class MoveToStart:
    """Moves the robot to its start, then runs the camera controller.

    Args:
        camera: the controller.
        limits: of the robot's increments.
        start: (n,) where to begin; None for where the robot stands [rad or m].
        distances_m: view distances that the operator selects, one after the other; none leaves it unchanged [m].
        hold_s: time that each is kept; the last is kept for ever [s].

    Attributes:
        began_s: stamp of the state with which the camera controller began; None before [s].
    """

    def __init__(
        self,
        camera: FocusController,
        limits: IncrementLimits,
        start: Array | None = None,
        distances_m: Sequence[float] = (),
        hold_s: float = 8.0,
    ) -> None:
        if start is not None and start.shape != limits.max_dq.shape:
            raise ControllerError(
                f"start: the robot has {len(limits.max_dq)} joints, got {start.size} values"
            )
        self.began_s: float | None = None
        self._camera, self._limits = camera, limits
        self._start, self._distances_m, self._hold_s = start, tuple(distances_m), hold_s
        self._last = LastIncrement(limits.max_ddq)
        self._last_q: Array | None = None

    def increment(self, view: View) -> Array:
        """The increment for this cycle, (n,) [rad or m]."""
        dq_last = self._last.update(view.own)
        if self.began_s is None:
            if not self._arrived(view.own, dq_last):
                return self._limits.admissible(self._onward(view.own.q_cmd), view.own.q_cmd, dq_last)
            self.began_s = view.own.time_s
        if self._distances_m:
            turns = int((view.own.time_s - self.began_s) / self._hold_s)
            self._camera.desired_distance_m = self._distances_m[min(turns, len(self._distances_m) - 1)]
        return self._camera.increment(view)

    def _arrived(self, own: RobotView, dq_last: Array) -> bool:
        if self._start is None:
            return True
        # the robot itself follows its setpoint some cycles behind, and is still under way when the setpoint rests
        moved = np.inf if self._last_q is None else np.abs(own.q - self._last_q).max()
        self._last_q = own.q
        return bool(max(np.abs(self._start - own.q_cmd).max(), np.abs(dq_last).max(), moved) < ARRIVED)

    def _onward(self, q_cmd: Array) -> Array:
        """A step along the straight line to the start from which all joints can still stop there."""
        assert self._start is not None  # else the robot has arrived
        way = self._start - q_cmd
        far = np.maximum(np.abs(way), 1e-12)
        speed = SPEED_SHARE * self._limits.max_dq / far
        brake = np.sqrt(2.0 * BRAKE_SHARE * self._limits.max_ddq / far)
        share = min(float(speed.min()), float(brake.min()), 1.0)
        return share * way


# How well the leader was seen in a run: the cycles of each sight, and when it changed.

MOST_CHANGES = 100
"""Changes that are remembered, the newest."""


class Sightings:
    """Counts of a follower's sight of its leader."""

    def __init__(self) -> None:
        self._cycles: Counter[Sight] = Counter()
        self._sight: Sight | None = None
        self._changes: deque[dict[str, Any]] = deque(maxlen=MOST_CHANGES)

    def add(self, sight: Sight, age_s: float, time_s: float) -> bool:
        """Count a cycle; True if the sight of the leader has changed. A first view that is fresh is no change.

        Args:
            sight: how well the leader is seen.
            age_s: of its state [s].
            time_s: stamp of the own robot's state [s].
        """
        self._cycles[sight] += 1
        before, self._sight = self._sight, sight
        if sight is before or (before is None and sight is Sight.FRESH):
            return False
        self._changes.append({"time_s": time_s, "sight": sight.value, "age_s": age_s})
        return True

    def summary(self) -> dict[str, Any]:
        """Cycles of each sight, and the newest changes, as a JSON object."""
        return {**{sight.value: self._cycles[sight] for sight in Sight}, "changes": list(self._changes)}


_log = logging.getLogger(__name__)


class FollowerProcess:
    """Connects, follows, and records the figures.

    Args:
        options: the command line.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options
        self._statistics = ControlStatistics()
        self._angle, self._distance, self._age = ErrorStatistics(), ErrorStatistics(), ErrorStatistics()
        self._began_s: float | None = None
        self._sightings = Sightings()
        self._target: ViewTarget | None = None
        self._reading: ClockReading | None = None

    async def follow(self) -> None:
        """Follow for as long as asked; with another tool of a robot, begin anew with its model."""
        while True:
            try:
                return await self._follow()
            except ToolChangedError as error:
                _log.info("%s", error)

    async def _follow(self) -> None:
        options = self._options
        async with connect(options.url, client="camera-follower") as cell:
            description = cell.description
            model = cell_model(description)
            roles = camera_roles(model.description, options.robot, options.leader)
            options.robot, options.leader = roles.follower, roles.leader
            scene = Scene(model, options.robot, options.leader, tuple(options.aim_offset_m))
            focus = None if options.focus_m is None else np.array(options.focus_m)
            cameras = {
                name: camera_controller_named(
                    options.controller, replace(scene, leader_name=name), options.distance_m, focus
                )
                for name in model.robots
                if name != options.robot
            }
            camera = CameraInUse(cameras, options.leader, Outlook(model, options.robot))
            limits = IncrementLimits.of(scene.robot, scene.cycle_s)
            start = None if options.start is None else np.array(options.start)
            move_to_start = MoveToStart(camera, limits, start, options.distances_m or (), options.hold_s)
            controller = HeldBack(move_to_start, round(options.view_delay_s / scene.cycle_s))
            self._reading = ClockReading(cell)
            await self._reading.read_first()
            _log.info("ready: %s follows %s", options.robot, options.leader)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(None) as timeout:
                    watch = partial(self._watch, camera, move_to_start, timeout)
                    seen = partial(_seen, camera, move_to_start)
                    await drive(
                        cell,
                        options.robot,
                        controller,
                        self._statistics,
                        watch,
                        seen,
                        camera.take,
                        self._reading,
                        description.coupled,
                    )

    def _watch(
        self, camera: CameraInUse, move_to_start: MoveToStart, timeout: asyncio.Timeout, view: View
    ) -> None:
        """Record the figures of a view; the time to follow for counts from the beginning of following."""
        options, other = self._options, view.others.get(camera.leader)
        if move_to_start.began_s is None or other is None:
            return
        if self._began_s is None:
            self._began_s = move_to_start.began_s
            if options.duration_s is not None:
                timeout.reschedule(asyncio.get_running_loop().time() + options.duration_s)
        if camera.leader_seen is not None:
            self._look(camera, camera.leader_seen.age_s, view.own.time_s)
        if self._reading is not None:
            age_s = self._reading.clocks.age_s(options.robot, other.time_s, time.monotonic())
            if age_s is not None:
                self._age.add(age_s, settled=True)
        angle, distance = camera.errors(view.own.q, other.q)
        settled = view.own.time_s - self._began_s >= options.settle_s
        self._angle.add(angle, settled)
        self._distance.add(distance, settled)

    def _look(self, camera: CameraInUse, age_s: float, time_s: float) -> None:
        """Count the controller's sight, and log changes of sight and target."""
        sight, target = camera.sight, camera.target
        if sight is not None and self._sightings.add(sight, age_s, time_s):
            if sight is Sight.FRESH:
                _log.info("%s: seen as asked for again", target.words())
            elif sight is Sight.HIDDEN:
                _log.warning("%s: %s by %s", target.words(), sight, ", ".join(camera.hidden_by))
            elif sight is Sight.OUT_OF_REACH:
                _log.warning("%s: %s: %s", target.words(), sight, ", ".join(camera.held_back_by))
            else:
                _log.warning("%s: %s, its state is %.2f s old", camera.leader, sight, age_s)
        if target != self._target:
            if self._target is not None:
                _log.info("looks at %s", target.words())
            self._target = target

    @property
    def robot(self) -> str:
        """The robot with the camera; empty before the cell has said which one has."""
        return self._options.robot or ""

    def summary(self) -> dict[str, Any]:
        """The figures as one JSON object."""
        return {
            "controller": self._options.controller,
            "robot": self._options.robot,
            "began_s": self._began_s,
            **self._statistics.summary(),
            "view": {
                **self._sightings.summary(),
                "age_s": self._age.figures(),
                "clocks": self._reading.clocks.summary(time.monotonic()) if self._reading else {},
            },
            "angle_deg": self._angle.figures(math.pi / 180.0),
            "distance_m": self._distance.figures(),
        }


def _seen(camera: CameraInUse, move_to_start: MoveToStart) -> tuple[Sight | None, ViewTarget | None]:
    """How well a controller sees its target, and the target; None before it looks at it."""
    return (None, None) if move_to_start.began_s is None else (camera.sight, camera.target)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the process; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_controllers.camera_follower",
        description="Follow the leader's tool with the camera; one JSON line of figures at the end.",
    )
    parser.add_argument("--url", default=DEFAULT_ADDRESS, help="where the HLI serves (default: %(default)s)")
    parser.add_argument("--robot", help="robot with the camera (default: the cell's first)")
    parser.add_argument("--leader", help="robot to follow (default: the first other one)")
    parser.add_argument(
        "--controller",
        default=FOLLOWS,
        help=f"{', '.join(NAMES)}, or your own as package.module:function (default: %(default)s)",
    )
    parser.add_argument("--distance-m", type=float, default=1.25, help="view distance (default: %(default)s)")
    parser.add_argument(
        "--distances-m", type=float, nargs="+", help="view distances to turn to, one after the other"
    )
    parser.add_argument(
        "--hold-s", type=float, default=8.0, help="time that each of them is kept (default: %(default)s)"
    )
    parser.add_argument(
        "--focus-m", type=float, nargs=3, help="point in the world to look at (default: the leader's tool)"
    )
    parser.add_argument(
        "--aim-offset-m",
        type=float,
        nargs=3,
        default=AIM_M,
        help="point of the leader's tool to look at, in the tool's frame (default: %(default)s)",
    )
    parser.add_argument(
        "--start", type=float, nargs="+", help="joints to go to first, rad or m (default: the present ones)"
    )
    parser.add_argument(
        "--view-delay-s",
        type=float,
        default=0.0,
        help="time by which the states of other robots are held back, for experiments (default: %(default)s)",
    )
    parser.add_argument(
        "--duration-s", type=float, default=None, help="time to follow for (default: for ever)"
    )
    parser.add_argument(
        "--settle-s",
        type=float,
        default=5.0,
        help="start-up that rms and max leave out (default: %(default)s)",
    )
    process = FollowerProcess(parser.parse_args(arguments))
    return run(process.follow(), process.summary, "follower", process.robot)


if __name__ == "__main__":
    raise SystemExit(main())
