# /// script
# requires-python = ">=3.11"
# dependencies = ["deltaq[cell]", "example-robot-data>=6.0"]
# ///
"""Filter a policy's joint targets through the gate, as LeRobot's `send_action` does: what is returned is sent."""

from deltaq import Box, Gate


class SafeAction:
    """Turns target positions by joint name into those that may be sent now [rad]."""

    def __init__(self, gate: Gate) -> None:
        self.gate, self.names = gate, gate.cell.robots["arm"].joint_names

    def __call__(self, action: dict[str, float]) -> dict[str, float]:
        """The target of this cycle, by `JOINT.pos` [rad]."""
        target = [action[f"{name}.pos"] for name in self.names]
        sent = self.gate.step(target - self.gate.q_cmd()).q_cmd
        return {f"{name}.pos": float(q) for name, q in zip(self.names, sent, strict=True)}


if __name__ == "__main__":
    urdf = "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
    fingers = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
    ready = [0, -0.785, 0, -2.356, 0, 1.571, 0.785]
    wall = Box((0.1, 2, 2), at=(0.7, 0, 1))
    gate = Gate.from_urdf(urdf, 0.02, {"wall": wall}, q=ready, locked=fingers)
    safe = SafeAction(gate)
    reach = dict(zip((f"{name}.pos" for name in safe.names), [0, 0.8, 0, -1.0, 0, 1.8, 0.785], strict=True))
    for _ in range(300):
        sent = safe(reach)
    print(
        f"panda_joint2 at {sent['panda_joint2.pos']:.3f} rad of {reach['panda_joint2.pos']}: {gate.nearest()}"
    )
