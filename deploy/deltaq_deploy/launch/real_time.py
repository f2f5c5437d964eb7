"""Real-time priority: what services and controllers ask for, and what the kernel gives to this user."""

from __future__ import annotations

import os
import resource
from contextlib import suppress
from pathlib import Path

from deltaq_deploy.launch.findings import DoctorFinding, Rating
from deltaq_protocol.real_time import SchedulingPriority

ASKED = max(SchedulingPriority)
"""The highest priority of SCHED_FIFO that a service asks for."""
_THROTTLE_US = Path("/proc/sys/kernel/sched_rt_runtime_us")
_PERIOD_US = Path("/proc/sys/kernel/sched_rt_period_us")


def examine_real_time() -> list[DoctorFinding]:
    """Ask as a service does, and check what keeps real-time services from starving the machine."""
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    return [
        judge_priority(_is_given(ASKED), limit),
        judge_throttling(_number(_THROTTLE_US), _number(_PERIOD_US)),
    ]


def judge_priority(given: bool, limit: int) -> DoctorFinding:
    """Result of asking for real-time priority.

    Args:
        given: whether the kernel gave the priority.
        limit: RLIMIT_RTPRIO of this user, -1 for none.
    """
    what, asked = "real-time priority", f"asked for SCHED_FIFO {ASKED}"
    bound = "unlimited" if limit == resource.RLIM_INFINITY else str(limit)
    if given:
        return DoctorFinding(what, f"{asked}: given (RLIMIT_RTPRIO {bound})", Rating.GOOD)
    return DoctorFinding(
        what,
        f"{asked}: refused (RLIMIT_RTPRIO {bound}); services run as SCHED_OTHER",
        Rating.FAIR,
        f"write `@realtime - rtprio {ASKED}` into /etc/security/limits.d/realtime.conf, join the group realtime and "
        "log in again; in a container, --cap-add SYS_NICE",
    )


def judge_throttling(runtime_us: int | None, period_us: int | None) -> DoctorFinding:
    """Whether the kernel reserves a fraction of the time for other programs, whatever real-time processes do.

    Args:
        runtime_us: time of a period that they may take, -1 for all of it; None if the kernel does not say [us].
        period_us: the period [us].
    """
    what = "real-time throttling"
    if runtime_us is None or not period_us:
        return DoctorFinding(
            what, "not told by this kernel", Rating.FAIR, "see sched_rt_runtime_us of your kernel"
        )
    if 0 <= runtime_us < period_us:
        return DoctorFinding(
            what, f"real-time processes get {runtime_us / period_us:.0%} at most", Rating.GOOD
        )
    return DoctorFinding(
        what,
        "off: a real-time process that never waits keeps its core for ever",
        Rating.FAIR,
        "sysctl -w kernel.sched_rt_runtime_us=950000 leaves 5 % to other programs",
    )


def _is_given(priority: int) -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


def _number(file: Path) -> int | None:
    with suppress(OSError, ValueError):
        return int(file.read_text(encoding="ascii"))
    return None
