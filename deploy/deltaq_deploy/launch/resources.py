"""What each kind of service may use of a machine: what it was seen to use, and room.

Seen in the lab cell at 12 ms with leader, follower and console: see `docs/how-to/containers.md`. Containers and systemd
have the same limits. They are there so that a leak or a flood takes one service and not the machine.
"""

from __future__ import annotations

from dataclasses import dataclass

from deltaq_deploy.launch.services import Role
from deltaq_protocol.real_time import SchedulingPriority


@dataclass(frozen=True)
class Resources:
    """Limits of one service.

    Attributes:
        memory_mb: of its processes and of what they keep in `/tmp` [MiB]; there is no swap beyond it.
        tasks: processes and threads.
        cores: of processor time; what runs at real-time priority is not slowed down by it.
        real_time: greatest real-time priority that it may ask for; 0 for none.
    """

    memory_mb: int
    tasks: int
    cores: float
    real_time: int = 0


RESOURCES: dict[Role, Resources] = {
    Role.ROBOT_SERVER: Resources(
        memory_mb=384, tasks=64, cores=1.0, real_time=SchedulingPriority.ROBOT_SERVER
    ),
    Role.EMULATOR: Resources(memory_mb=384, tasks=16, cores=1.0, real_time=SchedulingPriority.EMULATOR),
    Role.SIM: Resources(memory_mb=1024, tasks=64, cores=1.0, real_time=SchedulingPriority.SIM),
    Role.HLI: Resources(memory_mb=1024, tasks=384, cores=1.0, real_time=SchedulingPriority.HLI),
    Role.CONSOLE: Resources(memory_mb=2048, tasks=256, cores=2.0),
    Role.LEADER: Resources(memory_mb=768, tasks=64, cores=1.0, real_time=SchedulingPriority.CONTROLLER),
    Role.FOLLOWER: Resources(memory_mb=1024, tasks=64, cores=1.0, real_time=SchedulingPriority.CONTROLLER),
    Role.METRICS: Resources(memory_mb=384, tasks=64, cores=0.5),
    Role.RECORDER: Resources(memory_mb=768, tasks=64, cores=0.5),
}
