"""How many steps a second the environment makes, beside the bare cell in virtual time.

`python -m studies.training_speed` prints one JSON object a line. The bare cell repeats what the
environment's robots did: the same increments through the same gate, without observations, rewards and leader.
Of several passes the fastest counts, by the clock on the wall. `--environments` adds as many environments, each in a
process of its own.
"""

import argparse
import json
import time
from collections.abc import Sequence

import gymnasium
import numpy as np
from gymnasium.vector import AsyncVectorEnv

from deltaq_deploy.launch.program import run_program
from deltaq_experiments.scene import scene_of
from deltaq_experiments.training import ENVIRONMENT
from deltaq_experiments.training.environment import CameraEnvironment
from deltaq_protocol.arrays import Array
from deltaq_testing.virtual_cell.cell import VirtualCell

Setpoints = dict[str, Array]
"""Of each robot (steps + 1, n) [rad or m]."""

_LONG_ENOUGH_S = 1e6


def one_environment(steps: int, seed: int) -> tuple[float, Setpoints]:
    """Time of so many random steps [s], and the setpoints that they led through."""
    env = CameraEnvironment(duration_s=_LONG_ENOUGH_S)
    env.reset(seed=seed)
    env.action_space.seed(seed)
    states = env.episode.stack.states
    rows = {name: [state.q_cmd] for name, state in states.items()}
    elapsed_s = 0.0
    for action in [env.action_space.sample() for _ in range(steps)]:
        began_s = time.perf_counter()
        env.step(action)
        elapsed_s += time.perf_counter() - began_s
        for name, setpoints in rows.items():
            setpoints.append(states[name].q_cmd)
    return elapsed_s, {name: np.array(setpoints) for name, setpoints in rows.items()}


def bare_cell(setpoints: Setpoints) -> tuple[float, dict[str, Array]]:
    """Time of the same motion without the environment [s], and the last setpoint (n,) of each robot [rad or m]."""
    stack = VirtualCell("lab", {name: rows[0] for name, rows in setpoints.items()})
    stack.run_until_ready()
    for name in setpoints:
        stack.acquire(name, "speed")
    stack.cycle()
    # what was admitted then is admitted again; the leader asks first, as in an episode
    scene = scene_of(stack.cell)
    steps = {name: np.diff(setpoints[name], axis=0) for name in (scene.leader_name, scene.robot_name)}
    began_s = time.perf_counter()
    for step in range(len(steps[scene.leader_name])):
        for name, increments in steps.items():
            stack.ask(name, increments[step])
        stack.cycle()
    elapsed_s = time.perf_counter() - began_s
    return elapsed_s, {name: np.array(stack.states[name].q_cmd) for name in setpoints}


def many_environments(count: int, steps: int, seed: int) -> float:
    """Time of so many random steps of each of some environments [s]."""

    def make() -> gymnasium.Env[object, Array]:
        return gymnasium.make(f"deltaq_experiments.training:{ENVIRONMENT}", duration_s=_LONG_ENOUGH_S)

    envs = AsyncVectorEnv([make] * count)
    try:
        envs.reset(seed=seed)
        envs.action_space.seed(seed)
        began_s = time.perf_counter()
        for _ in range(steps):
            envs.step(envs.action_space.sample())
        return time.perf_counter() - began_s
    finally:
        envs.close()


def measure(steps: int, passes: int, environments: int, seed: int) -> list[dict[str, object]]:
    """The rows that are printed."""
    alone_s, setpoints = min((one_environment(steps, seed) for _ in range(passes)), key=lambda row: row[0])
    bare_s = min(bare_cell(setpoints)[0] for _ in range(passes))
    elapsed = [("bare cell", steps, bare_s), ("one environment", steps, alone_s)]
    if environments:
        many_s = min(many_environments(environments, steps, seed) for _ in range(passes))
        elapsed.append((f"{environments} environments", environments * steps, many_s))
    return [
        {
            "what": what,
            "steps_per_s": round(count / s, 1),
            "of_bare_cell": round(count / s / (steps / bare_s), 3),
        }
        for what, count, s in elapsed
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.training_speed",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--steps", type=int, default=500, help="of each pass (default: %(default)s)")
    parser.add_argument(
        "--passes", type=int, default=3, help="of which the fastest counts (default: %(default)s)"
    )
    parser.add_argument("--environments", type=int, default=0, help="side by side (default: none)")
    parser.add_argument(
        "--seed", type=int, default=0, help="of starts, leaders and actions (default: %(default)s)"
    )
    options = parser.parse_args(argv)
    for name, least in (("steps", 1), ("passes", 1), ("environments", 0), ("seed", 0)):
        if getattr(options, name) < least:
            parser.error(f"--{name} {getattr(options, name)}: at least {least}")
    for row in measure(options.steps, options.passes, options.environments, options.seed):
        print(json.dumps(row), flush=True)
    return 0


if __name__ == "__main__":
    run_program(main, "studies.training_speed")
