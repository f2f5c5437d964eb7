"""Runs a recording through the gate again, and compares all outputs bit for bit.

The recorded inputs of the gate go into the same core in the same order, after a recorded snapshot of the gate was
restored. Every admission, verdict, order and reply must be equal to the last bit, and so must every later snapshot;
the receipts of the recorded refusals must form one chain. After a gap in the recording the replay continues from the
next snapshot.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.guarded import Admission, GateMemory
from deltaq_protocol.messages import Message, Verdict
from deltaq_protocol.receipts import receipt_of
from deltaq_protocol.topic import Topic
from deltaq_services.outputs import ToTopic
from deltaq_services.recorder.reader import Recorded, Recording
from deltaq_services.sim.core import Sim

TAKEN_IN = (topics.SERVER_STATE, topics.REQUEST, topics.COMMAND)
GIVEN_OUT = (topics.ADMISSION, topics.SUPERVISION, topics.GATE_VERDICT, topics.COMMAND_REPLY)

DIFFERENCES_TOLD = 20
_NUMBERS = 2**32


@dataclass(frozen=True)
class Difference:
    """One field whose value differs from the recorded one.

    Attributes:
        number: of the message that the gate had taken.
        cycle: of the robot; None where the message has none.
        robot: its name, or "".
        topic: of the output.
        field: path of the field; "" where one of the two messages is missing.
        recorded: its value in the recording.
        replayed: its value now.
    """

    number: int
    cycle: int | None
    robot: str
    topic: str
    field: str
    recorded: Any
    replayed: Any

    def __str__(self) -> str:
        where = " ".join(part for part in (self.robot, f"cycle {self.cycle}", self.topic, self.field) if part)
        return f"message {self.number}: {where}: recorded {self.recorded!r}, replayed {self.replayed!r}"


@dataclass
class Replay:
    """Result of a replay.

    Attributes:
        messages: of the gate that were replayed.
        verdicts: compared.
        admissions: compared.
        receipts: of the recorded chain that were verified.
        memories: snapshots compared.
        differences: the first ones.
        difference_count: all of them.
        broken_receipts: verdicts whose receipt does not follow from the one before.
        gaps: places where messages of the gate are missing.
        skipped: messages of the gate that could not be replayed, since no snapshot came before them.
        verdicts_sha256: one hash over all verdicts that were replayed.
        recorded_sha256: the same of the recorded verdicts beside them.
        fingerprint: of the gate that replayed.
        recorded_fingerprint: of the gate that was recorded.
        notices: the parts that could not be read.
    """

    messages: int = 0
    verdicts: int = 0
    admissions: int = 0
    receipts: int = 0
    memories: int = 0
    differences: list[Difference] = field(default_factory=list)
    difference_count: int = 0
    broken_receipts: list[str] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)
    skipped: int = 0
    verdicts_sha256: str = ""
    recorded_sha256: str = ""
    fingerprint: str = ""
    recorded_fingerprint: str = ""
    notices: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Verdicts were compared, nothing differs and the chain of receipts holds."""
        return self.verdicts > 0 and not self.difference_count and not self.broken_receipts


def replay(
    path: Path,
    on_progress: Callable[[int, int], None] | None = None,
    make_sim: Callable[[CellModel, int], Sim] = Sim,
) -> Replay:
    """Replay a recording.

    Args:
        path: the file.
        on_progress: called with the bytes read and the bytes in all.
        make_sim: makes the gate from the cell's model and an epoch.

    Raises:
        UnreadableRecordingError: the file is no recording.
        CellError: this version cannot read the recorded cell.
    """
    recording = Recording.open(path)
    size = recording.size
    run = _Run(make_sim(recording.cell(), 0))
    for steps, exchange in enumerate(_exchanges(recording)):
        run.exchange(exchange)
        if on_progress is not None and steps % 64 == 0:
            on_progress(exchange.taken.position, size)
    return run.result(recording.notices)


@dataclass
class _Exchange:
    """A message that the gate took, or a snapshot of the gate, and the outputs.

    `whole` is false where the recording breaks off after it, so that some of the outputs may be missing.
    """

    taken: Recorded
    given: list[Recorded] = field(default_factory=list)
    whole: bool = True


def _exchanges(recording: Recording) -> Iterator[_Exchange]:
    """What passed the gate, in its order."""
    exchange: _Exchange | None = None
    for recorded in recording.messages((*TAKEN_IN, *GIVEN_OUT, topics.GATE_MEMORY)):
        number = recorded.number
        if recorded.topic in GIVEN_OUT:
            # an output that does not belong to the message before it answers a missing one
            if exchange is not None and number == exchange.taken.number:
                exchange.given.append(recorded)
            continue
        if exchange is not None:
            before = exchange.taken.number
            exchange.whole = number == (
                before if recorded.topic is topics.GATE_MEMORY else (before + 1) % _NUMBERS
            )
            yield exchange
        exchange = _Exchange(recorded)
    if exchange is not None:
        exchange.whole = not recording.notices
        yield exchange


class _Run:
    """A replay still running."""

    def __init__(self, sim: Sim) -> None:
        self._sim = sim
        self._in_step = False
        self._last: int | None = None
        self._receipt: str | None = None
        self._hashes = (hashlib.sha256(), hashlib.sha256())
        self._result = Replay(fingerprint=sim.fingerprint)

    def exchange(self, exchange: _Exchange) -> None:
        """One message that the gate took, or one of its snapshots."""
        taken = exchange.taken
        if isinstance(taken.message, GateMemory):
            self._remember(taken, taken.message)
            return
        result, sim = self._result, self._sim
        if self._last is not None and taken.number != (self._last + 1) % _NUMBERS:
            result.gaps.append(
                f"after message {self._last} of the gate comes {taken.number}: those between are missing"
            )
            self._in_step = False
        self._last = taken.number
        self._in_step = self._in_step and exchange.whole
        if not self._in_step:
            result.skipped += 1
            return
        result.messages += 1
        try:
            outputs = sim.take(taken.message)
        except Exception as error:  # a made-up recording raises many unrelated types
            self._raised(taken, error)
        else:
            self._compare(taken, exchange.given, outputs)

    def result(self, notices: list[str]) -> Replay:
        """The result."""
        result = self._result
        result.verdicts_sha256, result.recorded_sha256 = (digest.hexdigest() for digest in self._hashes)
        result.notices = list(notices)
        return result

    def _raised(self, taken: Recorded, error: Exception) -> None:
        """The gate failed on this message; continue from its next snapshot."""
        self._in_step = False
        self._tell(taken.number, taken.topic, taken.message, "", "taken", repr(error))

    def _remember(self, taken: Recorded, memory: GateMemory) -> None:
        result, sim = self._result, self._sim
        result.recorded_fingerprint = memory.fingerprint
        if self._in_step and (memory.epoch, memory.number) == (sim.epoch, sim.taken):
            result.memories += 1
            mine = sim.snapshot().model_copy(update={"fingerprint": memory.fingerprint})
            if mine != memory:
                self._differ(memory.number, topics.GATE_MEMORY, memory, mine)
            else:
                return
        if memory.epoch != sim.epoch:
            # another process of the SIM with new counts: from here on the recorded state applies
            self._last = None
        try:
            sim.restore(memory)
        except Exception as error:  # as above
            self._raised(taken, error)
            return
        self._in_step = True
        self._receipt = memory.receipt

    def _compare(self, taken: Recorded, given: list[Recorded], outputs: list[ToTopic]) -> None:
        result, number = self._result, self._sim.taken
        recorded = [(item.topic, item.message) for item in given]
        replayed = [(item.topic, item.message) for item in outputs]
        for which, messages in enumerate((replayed, recorded)):
            for topic, message in messages:
                if topic is topics.GATE_VERDICT:
                    self._hashes[which].update(message.model_dump_json().encode() + b"\n")
        for _, message in recorded:
            if isinstance(message, Verdict):
                result.verdicts += 1
                self._verify(message, number)
            elif isinstance(message, Admission):
                result.admissions += 1
        if [topic for topic, _ in recorded] != [topic for topic, _ in replayed]:
            self._tell(number, taken.topic, taken.message, "", _names(recorded), _names(replayed))
            return
        for (topic, was), (_, now) in zip(recorded, replayed, strict=True):
            if not _same(was, now):
                self._differ(number, topic, was, now)

    def _verify(self, verdict: Verdict, number: int) -> None:
        if verdict.receipt is None:
            return
        assert self._receipt is not None  # in step, so there was a snapshot
        if verdict.receipt == receipt_of(self._receipt, verdict):
            self._result.receipts += 1
        else:
            self._result.broken_receipts.append(
                f"message {number}: {verdict.robot} cycle {verdict.cycle}: receipt {verdict.receipt} does not follow "
                f"from {self._receipt} and this verdict"
            )
        self._receipt = verdict.receipt

    def _differ(self, number: int, topic: Topic, was: Message, now: Message) -> None:
        for path, recorded, replayed in differing_fields(was.model_dump(), now.model_dump()):
            self._tell(number, topic, was, path, recorded, replayed)

    def _tell(
        self, number: int, topic: Topic, message: Message, path: str, recorded: Any, replayed: Any
    ) -> None:
        result = self._result
        result.difference_count += 1
        if len(result.differences) < DIFFERENCES_TOLD:
            robot = getattr(message, "robot", None) or ""
            cycle = getattr(message, "cycle", None)
            result.differences.append(Difference(number, cycle, robot, topic.name, path, recorded, replayed))


def differing_fields(was: Any, now: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Path, old and new value of every leaf in which two dumped messages differ, to the sign of a zero."""
    if isinstance(was, dict) and isinstance(now, dict):
        for key in [*was, *(key for key in now if key not in was)]:
            yield from differing_fields(was.get(key), now.get(key), f"{path}.{key}".strip("."))
    elif isinstance(was, list | tuple) and isinstance(now, list | tuple) and len(was) == len(now):
        for index, (one, other) in enumerate(zip(was, now, strict=True)):
            yield from differing_fields(one, other, f"{path}[{index}]")
    elif was != now or (isinstance(was, float) and was.hex() != now.hex()):
        yield path, was, now


def _same(was: Message, now: Message) -> bool:
    return was.model_dump_json() == now.model_dump_json()


def _names(messages: list[tuple[Topic, Message]]) -> str:
    return ", ".join(topic.name for topic, _ in messages) or "nothing"
