# /// script
# requires-python = ">=3.11"
# dependencies = ["deltaq[cell]", "gymnasium>=1.0", "example-robot-data>=6.0"]
# ///
"""Train on any arm without breaking it: a Gymnasium wrapper whose actions pass the gate."""

from typing import Any

import gymnasium
import numpy as np

from deltaq import Box, Gate


class Gated(gymnasium.ActionWrapper[Any, Any, Any]):
    """Sends what the gate admits of each action: velocities (n,) [rad/s]."""

    def __init__(self, env: gymnasium.Env[Any, Any], gate: Gate, cycle_s: float) -> None:
        super().__init__(env)
        self.gate, self.cycle_s = gate, cycle_s

    def action(self, action: Any) -> Any:
        """The velocities that may be sent now (n,) [rad/s]."""
        return self.gate.step(np.asarray(action) * self.cycle_s).dq / self.cycle_s


if __name__ == "__main__":
    urdf = "package://example-robot-data/robots/ur_description/urdf/ur5_robot.urdf"
    table = Box((1, 1, 0.1), at=(0.6, 0, -0.1))
    gate = Gate.from_urdf(urdf, 0.008, {"table": table}, q=[0, -1.2, 1.2, -1.5, -1.5, 0])
    dive = np.array([0, 1.0, 0, 0, 0, 0])  # [rad/s], into the table
    steps = [gate.step(dive * 0.008) for _ in range(300)]
    print(f"{steps[-1].outcome}: {steps[-1].why}")
