"""Recording a run in virtual time, with the writer that records a running cell."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Command, Request, ServerState
from deltaq_protocol.messages import Message
from deltaq_protocol.topic import Topic
from deltaq_services.hli.outputs import Output as HliOutput
from deltaq_services.hli.outputs import ToOpen
from deltaq_services.recorder.writer import RecordingWriter
from deltaq_services.sim.answers import Output
from deltaq_services.sim.core import Sim
from deltaq_services.sim.gate_log import memory_is_due
from deltaq_verification.lockstep import Lockstep


@contextmanager
def lockstep(
    cell_name: str | Path, start: Mapping[str, Array] | None = None, record: Path | None = None
) -> Iterator[Lockstep]:
    """The stack in virtual time for the length of the block, recorded where `record` names a file.

    Where that file is there already the next number is added to its name: an experiment may be several runs.

    Raises:
        RecordingError: the file cannot be written.
    """
    if record is None:
        yield Lockstep(cell_name, start)
        return
    stack = RecordedLockstep(cell_name, start, not_there_yet(record))
    try:
        yield stack
    finally:
        stack.writer.close()


def not_there_yet(path: Path) -> Path:
    """The path, or where there is such a file already, the same with the next number added to its name."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(candidate for candidate in chain([path], numbered) if not candidate.exists())


class RecordedLockstep(Lockstep):
    """A cell in virtual time that records what a recorder of a running cell would.

    Attributes:
        writer: of the recording, to be closed in the end.
    """

    def __init__(self, cell_name: str | Path, start: Mapping[str, Array] | None, record: Path) -> None:
        super().__init__(cell_name, start)
        self.writer = RecordingWriter(record, self.cell.description_message(), "virtual time")
        self.sim = _RecordedSim(self.cell, self.sim.epoch, self._gate_took)
        self.writer.gate_remembers(self.sim.snapshot(), 0)

    @property
    def time_ns(self) -> int:
        """Virtual time [ns]."""
        return round(self.time_s * 1e9)

    def _gate_took(self, topic: Topic, message: Message, outputs: list[Output]) -> None:
        answered = [(output.topic, output.message) for output in outputs]
        self.writer.gate_took(topic, message, answered, self.sim.taken, self.time_ns)
        if memory_is_due(self.sim.taken):
            self.writer.gate_remembers(self.sim.snapshot(), self.time_ns)

    def _from_hli(self, outputs: list[HliOutput]) -> None:
        for output in outputs:
            if isinstance(output, ToOpen):
                self.writer.publish(output.topic, output.message, self.time_ns)
        super()._from_hli(outputs)


class _RecordedSim(Sim):
    """The gate's core, with a log of its inputs and outputs."""

    def __init__(
        self, cell: CellModel, epoch: int, took: Callable[[Topic, Message, list[Output]], None]
    ) -> None:
        super().__init__(cell, epoch)
        self._took = took

    def on_state(self, state: ServerState) -> list[Output]:
        return self._told(topics.SERVER_STATE, state, super().on_state(state))

    def on_request(self, request: Request) -> list[Output]:
        return self._told(topics.REQUEST, request, super().on_request(request))

    def on_command(self, command: Command) -> list[Output]:
        return self._told(topics.COMMAND, command, super().on_command(command))

    def _told(self, topic: Topic, message: Message, outputs: list[Output]) -> list[Output]:
        self._took(topic, message, outputs)
        return outputs
