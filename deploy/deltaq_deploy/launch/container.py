"""One container of the compose file: a service of the table, as locked up as it can work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deltaq_deploy.launch.resources import RESOURCES
from deltaq_deploy.launch.services import Role, Service
from deltaq_protocol.heartbeat import HEALTH_FILE
from deltaq_protocol.log import FORMAT

USER = 10001
"""Of every container, and of nobody on the host: the image has it as `deltaq`."""
_TMP_MB = 128
_HEALTH = "/tmp/health"

HARDENED: dict[str, Any] = {
    "image": "deltaq",
    "pull_policy": "never",  # nobody else's image of that name
    "user": f"{USER}:{USER}",
    "read_only": True,
    "cap_drop": ["ALL"],
    "security_opt": ["no-new-privileges:true"],
    "logging": {"driver": "local", "options": {"max-size": "10m", "max-file": "3"}},
}


def container(service: Service, cell_name: str) -> dict[str, Any]:
    """A container that runs a service of a cell."""
    command = ["python", *service.arguments]
    if service.role is Role.ROBOT_SERVER:
        # should it die, a process beside it brakes the robot, which the end of the container would kill
        command = ["until-all-ended", *command]
    found = HARDENED | {
        "command": command,
        # RSI counts single milliseconds, and a KRC on the plant's network sends to this host's address
        "network_mode": "host",
        "restart": "unless-stopped",
        "stop_grace_period": "20s",
        # the health file, and the machine code that numba copies to where it can write
        "tmpfs": [f"/tmp:mode=1777,size={_TMP_MB}m"],
        "environment": {FORMAT: f"${{{FORMAT}:-text}}"},
        **_limits(service.role),
    }
    if Path(cell_name).is_absolute():
        found["volumes"] = [f"{cell_name}:{cell_name}:ro"]
    if service.needs:
        found["depends_on"] = {name: {"condition": "service_healthy"} for name in service.needs}
    if service.probe is not None:
        found["environment"][HEALTH_FILE] = _HEALTH
        found["healthcheck"] = {
            "test": ["CMD", "healthy", _HEALTH],
            # what waits for a healthy service waits for the next look: engines before 25 know no start_interval
            "interval": "5s",
            "timeout": "5s",
            "retries": 3,
            "start_period": "120s",
        }
    return found


def real_time(service: Service) -> dict[str, Any]:
    """The limit with which a container may ask for real-time priority; empty for a service that never asks.

    Not part of a container, since an engine without the rights of root cannot raise a limit and starts nothing then.
    """
    priority = int(RESOURCES[service.role].real_time)  # a number, not its name
    return {"ulimits": {"rtprio": priority}} if priority else {}


def _limits(role: Role) -> dict[str, Any]:
    resources = RESOURCES[role]
    return {
        "mem_limit": f"{resources.memory_mb}m",
        "memswap_limit": f"{resources.memory_mb}m",  # no swap: a cycle does not wait for a disk
        "pids_limit": resources.tasks,
        "cpus": resources.cores,
    }
