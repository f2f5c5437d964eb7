"""What the HLI says of one robot, as short as it goes."""

from deltaq_protocol.messages import LeaseStatus, Phase, RobotState, RobotStatus, Status, ToolPose

NO_LEASE = LeaseStatus(holder=None, expires_s=None, epoch=0)


def told_state(cycle: int, time_s: float, robot: str = "fr") -> RobotState:
    pose = ToolPose(position=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
    joints = {"q": (0.0,), "q_cmd": (0.0,)}
    return RobotState(robot=robot, cycle=cycle, ipoc=0, time_s=time_s, tool=pose, phase=Phase.READY, **joints)


def told_status(**robots: tuple[int, float | None]) -> Status:
    """A status with cycle and age [s] of the newest state of each robot."""
    told = {
        name: RobotStatus(
            phase=Phase.READY, reason=None, cycle=cycle, state_age_s=age_s, q=(), lease=NO_LEASE, counters={}
        )
        for name, (cycle, age_s) in robots.items()
    }
    return Status(cell="lab", robots=told, gate={}, gate_age_s=None, hli={})
