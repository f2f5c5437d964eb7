"""A small cell for tests of what lies between controllers and gate: fr with six joints, gr with nine."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from deltaq_cell.cell_model import robot_summary
from deltaq_cell.description import CellDescription
from deltaq_cell.identity import content_identity
from deltaq_protocol.guarded import Admission, Plan, ServerState
from deltaq_protocol.messages import Description, Phase, ToolPose
from deltaq_testing.private_cell import free_ports

REVOLUTE = {
    "home_deg": 0.0,
    "lower_deg": -170.0,
    "upper_deg": 170.0,
    "max_velocity_deg_s": 90.0,
    "max_acceleration_rad_s2": 4.0,
}
PRISMATIC = {
    "home_m": 0.5,
    "lower_m": 0.0,
    "upper_m": 1.5,
    "max_velocity_m_s": 0.5,
    "max_acceleration_m_s2": 2.0,
}


def free_port() -> int:
    """A port of the loopback that nobody listens on, and that no other process of these tests draws."""
    return free_ports(1)[0]


def endpoint() -> str:
    """A zenoh endpoint that nobody listens on."""
    return f"tcp/127.0.0.1:{free_port()}"


def small_cell(**changes: Any) -> CellDescription:
    """The description, every port of it free."""
    arm = {f"a{k}": REVOLUTE for k in range(1, 7)}
    gantry = {f"e{k}": PRISMATIC for k in range(1, 4)}
    driver = {"kind": "kinematic"}
    fields: dict[str, Any] = {
        "cell": "small",
        "cycle_s": 0.012,
        "robots": {
            "fr": {"model": "kr16", "driver": driver, "joints": arm},
            "gr": {
                "model": "kr16_gantry",
                "driver": driver,
                "joints": gantry | arm,
                "outputs": ["gripper"],
                "inputs": ["closed"],
            },
        },
        "contacts": {"gripper_on_valves": {"bodies": ["gr/gripper"], "against": ["structure/valve"]}},
        "hli": endpoint(),
        "tcp_port": free_port(),
    }
    return CellDescription.model_validate(fields | changes)


def told(cell: CellDescription) -> Description:
    """What clients are told about the cell."""
    return Description(
        cell=cell.cell,
        cycle_s=cell.cycle_s,
        robots={name: robot_summary(robot, cell.cycle_s) for name, robot in cell.robots.items()},
        yaml="cell: small\n",
        urdf=dict.fromkeys(cell.robots, "<robot/>"),
        identity=str(content_identity(cell)),
        coupled={name: None for name, robot in cell.robots.items() if robot.tools},
    )


def tool_pose(robot: str, q: tuple[float, ...], tool: str = "tool") -> ToolPose:
    """No kinematics: the first joint is the height of the tool."""
    return ToolPose(position=(0.0, 0.0, q[0]), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))


def server_state(
    robot: str = "fr", cycle: int = 100, phase: Phase = Phase.READY, **changes: Any
) -> ServerState:
    """A state as a Robot Server publishes it, at rest at q = 0.1."""
    n = len(changes["q"]) if "q" in changes else {"fr": 6, "gr": 9}.get(robot, 6)
    fields: dict[str, Any] = {
        "robot": robot,
        "process": 1,
        "cycle": cycle,
        "ipoc": 12 * cycle,
        "time_s": 0.012 * cycle,
        "q": (0.1,) * n,
        "q_cmd": (0.1,) * n,
        "dq": (0.0,) * n,
        "plan": Plan(dq=(0.0,) * n, brake_cycles=1, step=0),
        "epoch": 1,
        "sequence": 1,
        "phase": phase,
        "outputs": {"gripper": False} if robot == "gr" else {},
        "inputs": {"closed": True} if robot == "gr" else {},
    }
    return ServerState(**(fields | changes))


def admission_after(
    state: ServerState, increment: Iterable[float], brake_cycles: int, /, **changes: Any
) -> Admission:
    """What a gate may admit next to a Robot Server in this state."""
    fields: dict[str, Any] = {
        "robot": state.robot,
        "epoch": state.epoch,
        "sequence": state.sequence + 1,
        "cycle": state.cycle,
        "follows_sequence": state.sequence,
        "follows_q_cmd": state.q_cmd,
        "follows_dq": state.dq,
        "follows_resets": state.resets,
        "dq": tuple(np.asarray(increment).tolist()),
        "brake_cycles": brake_cycles,
    }
    return Admission(**(fields | changes))
