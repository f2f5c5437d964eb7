"""What one step of a camera controller costs: `python -m deltaq_experiments.step_bench` prints the distribution.

The views are those of a run in virtual time, closed by the controller itself; they are then answered again, one
after the other, and timed in processor time. Other programs still slow a step down, by the caches and the core that
they share. So all views are answered several times, each time by a fresh controller, and the least time of every step
counts: its cost on a quiet core. `one pass` is the distribution of a single pass.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Sequence

import numpy as np

from deltaq_controllers.camera.controllers import FocusController
from deltaq_controllers.interface import Controller, View
from deltaq_controllers.leader.attacking import AttackingLeader
from deltaq_controllers.leader.scripted import ScriptedLeader
from deltaq_experiments.options import Options
from deltaq_experiments.scene import camera_controller, load
from deltaq_experiments.virtual import record
from deltaq_launch.program import run_program
from deltaq_protocol.arrays import Array

PERCENTILES = (50.0, 90.0, 99.0, 99.9, 100.0)


class Listening:
    """A controller that keeps the views that it answered.

    Args:
        controller: that answers them.

    Attributes:
        views: all of them, in order.
    """

    def __init__(self, controller: Controller) -> None:
        self.views: list[View] = []
        self._controller = controller

    def increment(self, view: View) -> Array:
        """The controller's increment, (n,) [rad or m]."""
        self.views.append(view)
        return self._controller.increment(view)


def seconds_of_steps(controller: FocusController, views: Sequence[View]) -> Array:
    """(k,) processor time of each step, the garbage collector at work as in a live controller [s]."""
    gc.collect()
    gc.freeze()
    seconds = np.empty(len(views))
    for step, view in enumerate(views):
        begin = time.thread_time()
        controller.increment(view)
        seconds[step] = time.thread_time() - begin
    gc.unfreeze()
    return seconds


def percentiles_us(seconds: Array) -> dict[str, float]:
    """Each of `PERCENTILES` of (k,) times [µs]."""
    return {f"p{p:g}_us": round(float(np.percentile(seconds, p)) * 1e6, 1) for p in PERCENTILES}


def run(
    name: str, speed_m_s: float, attacked: bool, duration_s: float, passes: int
) -> tuple[dict[str, float], dict[str, float]]:
    """Time a controller in the lab cell.

    Args:
        name: of the controller.
        speed_m_s: of the leader's tool.
        attacked: the leader attacks the lens of a camera whose focus is fixed; else it moves about and is tracked.
        duration_s: length of the run that the views come from.
        passes: how often every view is answered.

    Returns:
        The percentiles on a quiet core, and those of one pass.
    """
    options = Options(duration_s=duration_s)
    scene = load(options)
    focus = scene.leader.forward(scene.leader.home)[:3, 3] if attacked else None
    leader: Controller = (
        AttackingLeader(scene.leader, scene.robot, scene.cycle_s, speed_m_s)
        if attacked
        else ScriptedLeader(scene.leader, scene.cycle_s, speed_m_s)
    )
    listening = Listening(camera_controller(scene, name, focus=focus))
    record(options, listening, leader)
    times = [
        seconds_of_steps(camera_controller(scene, name, focus=focus), listening.views) for _ in range(passes)
    ]
    return percentiles_us(np.min(times, axis=0)), percentiles_us(times[0])


def main() -> int:
    """Print one JSON object a line: a controller in a situation."""
    parser = argparse.ArgumentParser(prog="python -m deltaq_experiments.step_bench", description=__doc__)
    parser.add_argument("--controller", nargs="+", default=["paper", "qp"], help="default: paper qp")
    parser.add_argument("--speed-m-s", type=float, default=0.25, help="of the leader (default: %(default)s)")
    parser.add_argument("--duration-s", type=float, default=20.0, help="of each run (default: %(default)s)")
    parser.add_argument(
        "--passes", type=int, default=5, help="answers to each view, at least 1 (default: %(default)s)"
    )
    options = parser.parse_args()
    if options.passes < 1:
        parser.error(f"--passes {options.passes}: at least 1")
    for name in options.controller:
        for attacked in (False, True):
            quiet, once = run(name, options.speed_m_s, attacked, options.duration_s, options.passes)
            situation = "attacked" if attacked else "tracking"
            row = {"controller": name, "situation": situation, **quiet, "one pass": once}
            print(json.dumps(row), flush=True)
    return 0


if __name__ == "__main__":
    run_program(main, "deltaq_experiments.step_bench")
