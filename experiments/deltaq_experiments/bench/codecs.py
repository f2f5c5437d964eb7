"""What a cycle's messages and telegrams cost to write and read, beside bare libraries that do the like."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from xml.parsers import expat

import msgpack
import numpy as np

from deltaq_experiments.bench.rsi_reply import standing_telegrams
from deltaq_experiments.bench.table import BenchRow
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.guarded import Admission, Request, ServerState, Supervision
from deltaq_protocol.messages import Increment, Message, RobotState, Verdict
from deltaq_services.outputs import ToTopic
from deltaq_services.robot_server.rsi_driver import sensor_codec
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

_KINDS = (ServerState, RobotState, Increment, Request, Supervision, Admission, Verdict)
_SPEED = 0.1
"""Of the first joint, as a fraction of its greatest."""


class _OverheardCell(VirtualCell):
    """A virtual cell that keeps the newest message of each kind that passes the gate."""

    def __init__(self, loaded: LoadedCell) -> None:
        super().__init__(loaded)
        self.newest: dict[type[Message], Message] = {}

    def gate_takes(self, message: Message) -> list[ToTopic]:
        outputs = super().gate_takes(message)
        for one in (message, *(output.message for output in outputs)):
            if not (isinstance(one, Request) and one.dq is None):
                self.newest[type(one)] = one
        return outputs


def messages_of_a_cycle(loaded: LoadedCell, robot: str) -> list[Message]:
    """One message of each kind that one robot's cycle needs, from a cell in motion."""
    stack = _OverheardCell(loaded)
    model = loaded.model.robots[robot]
    dq = np.zeros(model.n)
    stack.run_until_ready()
    stack.acquire(robot, "bench")
    for cycle in range(20):
        stack.cycle()
        fastest = model.max_velocity[0] * loaded.model.description.cycle_s
        dq[0] = fastest * _SPEED * min(1.0, cycle / 10)
        stack.ask(robot, dq)
    state = stack.states[robot]
    increment = Increment(robot=robot, seq=20, cycle=state.cycle, dq=tuple(dq.tolist()), lease="0" * 32)
    newest = stack.newest | {RobotState: state, Increment: increment}
    return [newest[kind] for kind in _KINDS]


def messages(loaded: LoadedCell, robot: str, passes: int) -> BenchRow:
    """Packing and unpacking the messages of one robot's cycle, each once."""
    known = messages_of_a_cycle(loaded, robot)
    packed = [(type(message), pack(message)) for message in known]
    maps = [message.model_dump(mode="json") for message in known]

    def ours() -> None:
        for message in known:
            pack(message)
        for kind, data in packed:
            unpack(kind, data)

    def bare() -> None:
        for one in maps:
            msgpack.packb(one)
        for _, data in packed:
            msgpack.unpackb(data)

    seconds, references = _in_turn(ours, bare, passes)
    return BenchRow.of(
        f"the {len(known)} messages of a cycle packed and unpacked",
        "msgpack alone",
        seconds,
        references,
        no_bound_because="msgpack validates nothing, and this is 4 % of a cycle's time",
    )


def telegrams(loaded: LoadedCell, robot: str, passes: int) -> BenchRow:
    """Reading a telegram and writing the reply."""
    xml = loaded.ethernet_xml(robot)
    assert xml is not None  # asked only of a robot on RSI
    codec = sensor_codec(loaded.model.description, robot, xml)
    [telegram] = standing_telegrams(loaded, robot, 1)
    outputs = dict.fromkeys(loaded.model.robots[robot].description.outputs, False)
    correction = np.full(codec.joints, 1e-3)
    reply = codec.encode(1, correction, outputs)

    def ours() -> None:
        codec.encode(codec.decode(telegram).ipoc, correction, outputs)

    def bare() -> None:
        expat.ParserCreate().Parse(telegram, True)
        expat.ParserCreate().Parse(reply, True)

    seconds, references = _in_turn(ours, bare, passes)
    return BenchRow.of(
        "an RSI telegram read and its reply written",
        "expat reads both, and keeps nothing",
        seconds,
        references,
        no_bound_because="it is part of a reply, whose bound counts",
    )


def _in_turn(
    ours: Callable[[], None], bare: Callable[[], None], passes: int
) -> tuple[list[float], list[float]]:
    gc.collect()
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(passes):
        for work, seconds in zip((ours, bare), times, strict=True):
            begin = time.perf_counter()
            work()
            seconds.append(time.perf_counter() - begin)
    return times
