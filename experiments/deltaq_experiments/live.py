"""A camera experiment over real processes, zenoh and UDP, recorded by the emulated controllers themselves."""

import tempfile
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from deltaq_controllers.camera.scene import Scene
from deltaq_deploy.launch.bring_to_rest import bring_to_rest
from deltaq_deploy.launch.cell_connection import connect, listen
from deltaq_deploy.launch.child_process import Exited
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.program import LaunchError
from deltaq_deploy.launch.services import cell_services, demo_controllers, recorder
from deltaq_experiments.options import Options
from deltaq_experiments.scene import link_cycles
from deltaq_experiments.trace import Trace
from deltaq_experiments.virtual import RunRecord
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.codec import unpack
from deltaq_protocol.messages import RobotState
from deltaq_testing.live import recorded, with_arguments
from deltaq_testing.oracle import GateCounts, record_cycle_s
from deltaq_testing.recorded import not_there_yet

KEPT = 20
"""Lines that are kept."""


class LastLines:
    """Keeps the last lines of all services; any thread may add one."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=KEPT)

    def __call__(self, name: str, line: str) -> None:
        """Keep a line of a service."""
        self._lines.append(f"{name}: {line}")

    def text(self) -> str:
        """The lines, oldest first."""
        return "\n".join(self._lines.copy())  # at once, whatever is added meanwhile


START_S = 30.0
"""Longest time that the motion to the start of a run may take [s]."""


def run_live(
    options: Options, scene: Scene, following: Sequence[str] = (), leading: Sequence[str] | None = ()
) -> RunRecord:
    """Start the cell's services, a leader and a follower, and end all of them after the run.

    Args:
        options: with `length_s` known.
        scene: the roles of the robots.
        following: further arguments of `deltaq_controllers.camera_follower`.
        leading: further arguments of `deltaq_controllers.leader`; None lets the leader stand.

    Raises:
        LaunchError: if a service does not come up, or dies, or the follower does not reach its start.
    """
    cell, description = scene.cell, scene.cell.description
    with tempfile.TemporaryDirectory() as folder:
        records = {name: Path(folder, f"{name}.csv") for name in cell.robots}
        services = [recorded(service, records) for service in cell_services(description, str(options.cell))]
        leader, follower = demo_controllers(description)
        view_delay_s = link_cycles(scene, options.latency_s) * scene.cycle_s
        follower = with_arguments(
            follower, "--controller", options.controller, "--view-delay-s", f"{view_delay_s}"
        )
        follower = with_arguments(follower, "--robot", scene.robot_name, "--leader", scene.leader_name)
        follower = with_arguments(follower, "--duration-s", f"{options.length_s}", *following)
        if leading is not None:
            speed, seed = f"{options.leader_speed_m_s}", f"{options.seed}"
            leader = with_arguments(
                leader, "--robot", scene.leader_name, "--stick-m-s2", f"{options.stick_m_s2}"
            )
            services.append(with_arguments(leader, "--speed-m-s", speed, "--seed", seed, *leading))
        if options.record is not None:
            services.append(recorder(str(options.cell), str(not_there_yet(options.record))))
        lines = LastLines()
        launcher = Launcher([*services, follower], lines, lambda: bring_to_rest(description, "experiment"))
        with launcher:
            launcher.start()
            samples: list[bytes] = []
            with listen(description) as listener:
                # states alone, undecoded: a callback that works would slow the processes that are measured
                listener.subscribe(topics.STATE, lambda sample: samples.append(sample.payload.to_bytes()))
                event = launcher.wait(START_S + options.length_s)
            if event != Exited(follower.name, 0):
                why = "the follower did not get to its start" if event is None else f"{event}"
                raise LaunchError(f"the run was cut short: {why}; the last lines were\n{lines.text()}")
            with connect(description, "experiment") as running:
                status = running.status()
            launcher.stop_service("leader")
            summary = launcher.last_json(follower.name) or {}
        states = [unpack(RobotState, sample) for sample in samples]
        setpoints = {name: _setpoints(path, cell.robots[name].n) for name, path in records.items()}
        krc_cycle_s = {name: record_cycle_s(path) for name, path in records.items()}
    reasons = {k.removeprefix("reason_"): v for k, v in status.gate.items() if k.startswith("reason_")}
    trace = trace_of(states, tuple(cell.robots), setpoints, summary["began_s"], options.length_s)
    trace = replace(trace, krc_cycle_s=krc_cycle_s)
    return RunRecord(trace, GateCounts.of(status.gate), reasons)


def _setpoints(record: Path, joints: int) -> Array:
    """(m, n) setpoints of an emulated controller's record: after cycle, time and n measured joints."""
    columns = range(2 + joints, 2 + 2 * joints)
    return np.loadtxt(record, delimiter=",", skiprows=1, usecols=columns, ndmin=2)


def trace_of(
    states: Sequence[RobotState],
    names: tuple[str, ...],
    setpoints: dict[str, Array],
    began_s: float | None = None,
    length_s: float = np.inf,
) -> Trace:
    """The robots' measured joints on the first one's time stamps, the others interpolated.

    Args:
        states: of all robots, in order.
        names: of the robots.
        setpoints: (m, n) per robot [rad or m].
        began_s: stamp that time counts from; None for the first state's [s].
        length_s: time after it that counts [s].
    """
    times = {name: np.array([s.time_s for s in states if s.robot == name]) for name in names}
    joints = {name: np.array([s.q for s in states if s.robot == name]) for name in names}
    begin = times[names[0]][0] if began_s is None else began_s
    clock = times[names[0]] - begin
    clock = clock[(clock >= 0.0) & (clock <= length_s)]
    q = {
        name: np.column_stack([np.interp(clock, times[name] - begin, column) for column in joints[name].T])
        for name in names
    }
    return Trace(clock, q, setpoints)
