"""Recording a run in virtual time, with the writer that records a running cell."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import chain, count
from pathlib import Path

from deltaq_protocol import topics
from deltaq_protocol.arrays import Array
from deltaq_protocol.guarded import Command, Request, ServerState
from deltaq_protocol.messages import Message
from deltaq_protocol.topic import Realm
from deltaq_services.outputs import Output, ToTopic, published
from deltaq_services.recorder.writer import RecordingWriter
from deltaq_testing.virtual_cell.cell import VirtualCell

_TAKEN = {ServerState: topics.SERVER_STATE, Request: topics.REQUEST, Command: topics.COMMAND}


@contextmanager
def virtual_cell(
    cell_name: str | Path, start: Mapping[str, Array] | None = None, record: Path | None = None
) -> Iterator[VirtualCell]:
    """The stack in virtual time for the length of the block, recorded where `record` names a file.

    Where that file is there already the next number is added to its name: an experiment may be several runs.

    Raises:
        RecordingError: the file cannot be written.
    """
    if record is None:
        yield VirtualCell(cell_name, start)
        return
    stack = RecordedCell(cell_name, start, not_there_yet(record))
    try:
        yield stack
    finally:
        stack.writer.close()


def not_there_yet(path: Path) -> Path:
    """The path; if the file exists, the path with the next free number added to its name."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in count(2))
    return next(candidate for candidate in chain([path], numbered) if not candidate.exists())


class RecordedCell(VirtualCell):
    """A cell in virtual time, recorded like a running cell.

    Attributes:
        writer: of the recording, to be closed in the end.
    """

    def __init__(self, cell_name: str | Path, start: Mapping[str, Array] | None, record: Path) -> None:
        super().__init__(cell_name, start)
        self.writer = RecordingWriter(record, self.cell.description_message(), "virtual time")
        self.writer.gate_remembers(self.sim.snapshot(), 0)

    @property
    def time_ns(self) -> int:
        """Virtual time [ns]."""
        return round(self.now_s * 1e9)

    def gate_takes(self, message: Message) -> list[ToTopic]:
        """Log the gate's inputs and outputs, and now and then its state."""
        outputs = super().gate_takes(message)
        answered = [(output.topic, output.message) for output in outputs]
        self.writer.gate_took(_TAKEN[type(message)], message, answered, self.sim.taken, self.time_ns)
        if self.sim.memory_is_due:
            self.writer.gate_remembers(self.sim.snapshot(), self.time_ns)
        return outputs

    def carry_out(self, outputs: list[Output]) -> None:
        """Log the public messages."""
        for output in published(outputs, Realm.OPEN):
            self.writer.publish(output.topic, output.message, self.time_ns)
        super().carry_out(outputs)
