"""Reply time of a Robot Server, beside an echo of the same bytes: 9 axes, 4 ms, one core.

The Robot Server is a process as `deltaq up` starts it. It gets a heartbeat and an admission in every cycle, as from
the gate; since its robot is not ready, it decodes the admission and refuses it.
"""

import os
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_cell.identity import content_identity
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import cell_services, one
from deltaq_experiments.bench.hop_reference import program
from deltaq_experiments.bench.table import BenchRow
from deltaq_protocol import topics
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.envelope import Envelopes
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import Admission, ServerState, Supervision
from deltaq_protocol.real_time import SchedulingPriority, ask_for_real_time
from deltaq_protocol.rsi import AxisMap, KrcCodec, KrcReport, load_ethernet_xml
from deltaq_protocol.sayings import SIM, robot_server
from deltaq_protocol.session import declare_publisher, open_session
from deltaq_services.guarded_realm import guarded_links
from deltaq_testing.private_cell import free_ports
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

_FIRST_IPOC = 4_200_000
_POSE = (0.0,) * 6


def standing_telegrams(loaded: LoadedCell, robot: str, count: int) -> list[bytes]:
    """`count` telegrams of a robot's KRC, with the robot at rest at home."""
    description = loaded.model.description.robots[robot]
    driver, xml = description.driver, loaded.ethernet_xml(robot)
    assert isinstance(driver, RsiDescription)  # asked only of a robot on RSI
    assert xml is not None  # and so it has such a file
    axes = AxisMap.of(description.joint_names, description.units, driver.krc)
    codec = KrcCodec(load_ethernet_xml(xml), axes, driver.inputs, driver.outputs)
    q, inputs = description.home, dict.fromkeys(description.inputs, False)
    step = driver.ipoc_step or round(loaded.model.description.cycle_s * 1000)
    return [
        codec.encode(KrcReport(_FIRST_IPOC + cycle * step, q, q, _POSE, _POSE, 0, inputs))
        for cycle in range(count)
    ]


CELL, ROBOT = "lab-4ms", "gr"
"""Six axes on a gantry of three, at the shorter cycle."""
CYCLES = 2000
_LEFT_OUT = 250
"""Cycles of the beginning: a Robot Server has to believe in a session first."""
_LONGER_S = 20.0


def rsi_reply(cycles: int = CYCLES) -> BenchRow:
    """Time from a telegram to its reply.

    Args:
        cycles: telegrams that are timed.

    Raises:
        LaunchError: if the Robot Server does not come up.
        DeltaqError: if it does not answer.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = program("asker", folder)
        loaded = LoadedCell.load(_private(folder))
        cell, cycle_s = loaded.model.description, loaded.model.description.cycle_s
        driver = cell.robots[ROBOT].driver
        assert driver.kind == "rsi"  # the shipped cell's
        telegrams, file = folder / "telegrams", folder / "took"
        sent = standing_telegrams(loaded, ROBOT, cycles + _LEFT_OUT)
        telegrams.write_bytes(b"".join(struct.pack("=I", len(one)) + one for one in sent))
        service = one(cell_services(cell, str(loaded.file)), f"robot-server-{ROBOT}")
        arguments = (f"{round(cycle_s * 1e9)}", driver.address, f"{driver.port}", f"{telegrams}", f"{file}")
        with ExitStack() as stack:
            with _on_one_core():
                launcher = stack.enter_context(Launcher([service], lambda *_: None, signals_raise=True))
                launcher.start()
            stack.enter_context(_gate(cell))
            with _on_one_core():
                asker = subprocess.Popen([made, *arguments], stderr=subprocess.PIPE, text=True)
            try:
                _, said = asker.communicate(timeout=(cycles + _LEFT_OUT) * cycle_s + _LONGER_S)
            except subprocess.TimeoutExpired as error:
                raise DeltaqError("the reference of the RSI reply did not end") from error
            finally:
                asker.kill()
                asker.communicate()
        if asker.returncode != 0:
            raise DeltaqError(f"the reference of the RSI reply ended with {asker.returncode}: {said}")
        took = np.fromfile(file, dtype="=i8").reshape(-1, 2)[_LEFT_OUT:] / 1e9
    server, echo = (column[column >= 0.0].tolist() for column in took.T)
    if len(server) < cycles / 2 or len(echo) < cycles / 2:
        raise DeltaqError(f"of {cycles} telegrams {len(server)} were answered, {len(echo)} by the echo")
    return BenchRow.of(
        f"an RSI reply, {len(cell.robots[ROBOT].joints)} axes at {cycle_s * 1e3:g} ms, one core",
        "an echo of the same bytes in C",
        server,
        echo,
    )


@contextmanager
def _on_one_core() -> Iterator[None]:
    """Whatever is started inside stays on one core; of several the last, since the first serves most interrupts."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


@contextmanager
def _at_priority(priority: SchedulingPriority) -> Iterator[None]:
    """Threads that are started inside have a real-time priority, where the system allows it."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    ask_for_real_time(priority)
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)


@contextmanager
def _gate(cell: CellDescription) -> Iterator[None]:
    """Answers each state of the robot with a heartbeat and an admission, as early as the gate would."""
    endpoint = guarded_links(cell)[robot_server(ROBOT)]
    with _at_priority(SchedulingPriority.SIM):
        session = open_session(connect=[endpoint], must_connect=True)
    envelopes, identity = Envelopes(SIM, cell.cell, tuple(cell.robots)), str(content_identity(cell))
    state_key = topics.SERVER_STATE.key(cell.cell, robot=ROBOT)
    keys = {row: row.key(cell.cell, robot=ROBOT) for row in (topics.SUPERVISION, topics.ADMISSION)}
    heartbeats, admissions = (
        declare_publisher(session, key, envelopes, row.priority) for row, key in keys.items()
    )

    def answer(sample: object) -> None:
        enclosed = sample.payload.to_bytes()  # type: ignore[attr-defined] # zenoh has no types
        state = unpack(ServerState, envelopes.open(state_key, enclosed))
        heartbeat = Supervision(robot=ROBOT, epoch=1, cycle=state.cycle, cell=identity)
        admission = Admission(
            robot=ROBOT,
            epoch=1,
            sequence=1,
            cycle=state.cycle,
            follows_sequence=state.sequence,
            follows_q_cmd=state.q_cmd,
            follows_dq=state.dq,
            follows_resets=state.resets,
            dq=state.dq,
            brake_cycles=1,
        )
        heartbeats.put(pack(heartbeat))
        admissions.put(pack(admission))

    subscriber = session.declare_subscriber(state_key, answer)
    try:
        yield
    finally:
        subscriber.undeclare()
        session.close()


def _private(folder: Path) -> Path:
    """The cell on ports of its own, so that one that is up is not disturbed."""
    server, port = free_ports(2)
    file = folder / "private.yaml"
    file.write_text(
        f"extends: {CELL}\n"
        f"robots: {{{ROBOT}: {{server: tcp/127.0.0.1:{server}, driver: {{port: {port}}}}}}}\n",
        encoding="utf-8",
    )
    return file
