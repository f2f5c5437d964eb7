"""Recordings run through the gate again: nothing may differ, and nothing that differs may pass."""

import contextlib
import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from commands import deltaq
from rewritten import rewrite
from table import change_row

from deltaq_cell.cell_model import CellModel
from deltaq_deploy.command.recordings import notices
from deltaq_experiments.run_report.run import read_run
from deltaq_experiments.tracking import panels_of
from deltaq_protocol.arrays import Array
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Message, NearestPair, Verdict
from deltaq_protocol.receipts import receipt_of
from deltaq_protocol.topic import Messages
from deltaq_services.outputs import ToTopic
from deltaq_services.recorder.protobuf import recorded_schema, to_message
from deltaq_services.recorder.reader import Recording
from deltaq_services.recorder.replayed import replayed as as_the_console_shows
from deltaq_services.sim.core import Decider, Sim
from deltaq_services.sim.gate import Decision
from deltaq_services.sim.tracker import Tracker
from deltaq_testing.recorded import virtual_cell
from deltaq_testing.replay import Replay, differing_fields, replay

GATE_VERDICTS = ("deltaq-guarded/lab/fr/verdict", "deltaq-guarded/lab/gr/verdict")
CYCLES = 130
PERIOD = 100
"""Messages of the gate from one memory to the next, so that a short recording has several."""


def drive(file: Path, cycles: int = CYCLES, seed: int = 3) -> Path:
    """Both robots driven at random, with a stop, a refused reset and a granted one in between."""
    random = np.random.default_rng(seed)
    with virtual_cell("lab", record=file) as stack:
        stack.run_until_ready()
        wish = {name: np.zeros(arm.q.size) for name, arm in stack.arms.items()}
        for name in stack.arms:
            stack.acquire(name, f"driver of {name}")
        for cycle in range(cycles):
            stack.cycle()
            for name, dq in wish.items():
                dq += random.normal(scale=0.002, size=dq.size) - 0.02 * dq
                stack.ask(name, dq)
            if cycle == cycles // 2:
                stack.stop()
            if cycle in (cycles // 2 + 1, cycles // 2 + 50):
                for name in stack.arms:
                    stack.reset(name)
    return file


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        change_row(patch, "GATE_MEMORY", rate=Messages(PERIOD))
        return drive(tmp_path_factory.mktemp("recorded") / "run.mcap")


@pytest.fixture(scope="module")
def replayed(recorded: Path) -> Replay:
    return replay(recorded)


def changed_verdict(number: int, **changes: object) -> Callable[[str, int, bytes], bytes | None]:
    """Changes one verdict of a recording, as somebody would who wants it to have been otherwise."""

    def change(topic: str, sequence: int, data: bytes) -> bytes:
        if topic not in GATE_VERDICTS or sequence != number:
            return data
        schema = recorded_schema()
        verdict = to_message(Verdict, schema.classes[Verdict].FromString(data))
        encoded: bytes = schema.encode(verdict.model_copy(update=changes)).SerializeToString()
        return encoded

    return change


def verdicts(file: Path) -> list[tuple[int, Verdict]]:
    return [
        (item.number, item.message)
        for item in Recording.open(file).messages()
        if item.topic.name == "gate-verdict" and isinstance(item.message, Verdict)
    ]


@pytest.mark.long
def test_a_recording_replays_bit_for_bit(replayed: Replay) -> None:
    assert replayed.good
    assert replayed.differences == []
    assert replayed.skipped == 0
    assert replayed.verdicts > CYCLES
    assert replayed.admissions > 50
    assert replayed.receipts > 10
    assert replayed.memories >= 2
    assert replayed.verdicts_sha256 == replayed.recorded_sha256
    assert replayed.fingerprint == replayed.recorded_fingerprint


@pytest.mark.long
def test_a_run_in_virtual_time_gives_the_same_file_byte_for_byte(tmp_path: Path) -> None:
    one, other = drive(tmp_path / "one.mcap", 20), drive(tmp_path / "other.mcap", 20)
    assert one.read_bytes() == other.read_bytes()
    assert drive(tmp_path / "third.mcap", 20, seed=4).read_bytes() != one.read_bytes()


class ShuffledSim(Sim):
    """Measures its groups of bodies in an order of its own, and other distances in between."""

    def __init__(self, cell: CellModel, epoch: int) -> None:
        super().__init__(cell, epoch)
        self._random = np.random.default_rng(11)
        self.asked: list[NearestPair | None] = []
        self._alone, self._between = dict(self._proximity.alone), dict(self._proximity.between)

    def on_request(self, request):  # type: ignore[no-untyped-def] # as the core's own
        for lists, own in ((self._proximity.alone, self._alone), (self._proximity.between, self._between)):
            for key, groups in own.items():
                lists[key] = [groups[place] for place in self._random.permutation(len(groups))]
        if self._random.random() < 0.3:
            self.asked.append(self.nearest())
        return super().on_request(request)


@pytest.mark.long
def test_the_order_of_distance_measurements_changes_no_verdict(recorded: Path, replayed: Replay) -> None:
    sims: list[ShuffledSim] = []

    def make(cell: CellModel, epoch: int) -> Sim:
        sims.append(ShuffledSim(cell, epoch))
        return sims[-1]

    shuffled = replay(recorded, make_sim=make)
    assert len(sims[0].asked) > 20
    assert shuffled.differences == []
    assert shuffled.verdicts_sha256 == replayed.verdicts_sha256


@pytest.mark.long
def test_another_gate_is_detected_with_cycle_and_field(recorded: Path) -> None:
    def make(cell: CellModel, epoch: int) -> Sim:
        wider = cell.description.gate.model_copy(update={"stop_distance_m": 0.4})
        description = cell.description.model_copy(update={"gate": wider})
        return Sim(CellModel.of(description, cell.robots, cell.yaml), epoch)

    other = replay(recorded, make_sim=make)
    assert not other.good
    assert other.verdicts_sha256 != other.recorded_sha256
    assert other.fingerprint.split("-")[1] != other.recorded_fingerprint.split("-")[1]
    first = other.differences[0]
    assert first.cycle is not None
    assert first.robot in ("fr", "gr")
    assert first.recorded != first.replayed


@pytest.mark.long
def test_one_changed_bit_of_one_verdict_is_found(recorded: Path, tmp_path: Path) -> None:
    number, verdict = next((n, v) for n, v in verdicts(recorded) if v.outcome == "scaled")
    scale = float(np.nextafter(verdict.scale, 1.0))
    rewrite(recorded, tmp_path / "changed.mcap", changed_verdict(number, scale=scale))
    found = replay(tmp_path / "changed.mcap")
    assert found.difference_count == 1
    (difference,) = found.differences
    assert (difference.number, difference.cycle, difference.robot, difference.topic, difference.field) == (
        number, verdict.cycle, verdict.robot, "gate-verdict", "scale",
    )  # fmt: skip
    assert (difference.recorded, difference.replayed) == (scale, verdict.scale)


@pytest.mark.long
def test_a_changed_refusal_breaks_the_chain_of_receipts(recorded: Path, tmp_path: Path) -> None:
    refusals = [(n, v) for n, v in verdicts(recorded) if v.receipt is not None]
    number, verdict = refusals[5]
    forged = verdict.model_copy(update={"clearance_m": 1.0})
    # even with a receipt that fits the forged verdict the chain breaks, at the next link
    before = refusals[4][1].receipt
    assert before is not None
    assert receipt_of(before, verdict) == verdict.receipt
    receipt = receipt_of(before, forged)
    for changes, broken_at in (
        ({"clearance_m": 1.0}, number),
        ({"clearance_m": 1.0, "receipt": receipt}, refusals[6][0]),
    ):
        file = tmp_path / f"forged-{len(changes)}.mcap"
        rewrite(recorded, file, changed_verdict(number, **changes))
        found = replay(file)
        assert not found.good
        assert len(found.broken_receipts) == 1
        assert found.broken_receipts[0].startswith(f"message {broken_at}: ")


@pytest.mark.long
def test_a_removed_refusal_breaks_the_chain_of_receipts(recorded: Path, tmp_path: Path) -> None:
    number = [n for n, v in verdicts(recorded) if v.receipt is not None][5]
    file = tmp_path / "without.mcap"
    rewrite(
        recorded,
        file,
        lambda topic, sequence, data: None if topic in GATE_VERDICTS and sequence == number else data,
    )
    found = replay(file)
    assert found.difference_count
    assert len(found.broken_receipts) == 1


@pytest.mark.long
def test_after_a_gap_the_replay_continues_at_the_next_snapshot(recorded: Path, tmp_path: Path) -> None:
    file = tmp_path / "gap.mcap"
    rewrite(recorded, file, lambda topic, sequence, data: None if sequence in range(240, 260) else data)
    found = replay(file)
    assert found.gaps == ["after message 239 of the gate comes 260: those between are missing"]
    # what answered message 239 may be missing as well, so it is not compared either
    assert found.skipped == 300 - 260 + 2
    assert found.good
    assert found.messages > 300


@pytest.mark.long
def test_a_recording_begun_in_motion_replays_from_its_first_snapshot(
    recorded: Path, replayed: Replay, tmp_path: Path
) -> None:
    file = tmp_path / "joined.mcap"
    rewrite(
        recorded, file, lambda topic, sequence, data: None if "guarded" in topic and sequence < 220 else data
    )
    found = replay(file)
    assert found.good
    assert found.skipped == 300 - 220 + 1
    assert found.messages == replayed.messages - 300


@pytest.mark.long
def test_a_truncated_recording_is_replayed_up_to_its_end(recorded: Path, tmp_path: Path) -> None:
    # chunks of one message each, so that the file can end anywhere, between a message and its answers too
    rewrite(recorded, tmp_path / "fine.mcap", lambda topic, sequence, data: data, chunk_size=1)
    data, file = (tmp_path / "fine.mcap").read_bytes(), tmp_path / "cut.mcap"
    lengths = []
    for length in range(len(data) // 2, len(data) // 2 + 2100, 700):
        file.write_bytes(data[:length])
        found = replay(file)
        assert found.good, found.differences
        assert found.skipped <= 1
        assert len(found.notices) == 1
        lengths.append(found.messages)
    assert lengths == sorted(lengths)
    assert lengths[0] > 100


@pytest.mark.long
def test_the_command_reports_a_difference_by_cycle_and_field_with_exit_status_1(
    recorded: Path, replayed: Replay, tmp_path: Path
) -> None:
    good = deltaq("recording", "replay", str(recorded), "--json")
    assert good.returncode == 0, good.stderr
    assert json.loads(good.stdout)["verdicts_sha256"] == replayed.verdicts_sha256
    number, verdict = next((n, v) for n, v in verdicts(recorded) if v.outcome == "scaled")
    rewrite(recorded, tmp_path / "changed.mcap", changed_verdict(number, seq=99))
    bad = deltaq("recording", "replay", str(tmp_path / "changed.mcap"))
    assert bad.returncode == 1
    told = f"differs: message {number}: {verdict.robot} cycle {verdict.cycle} gate-verdict seq: recorded 99, replayed"
    assert told in bad.stdout
    none = deltaq("recording", "replay", str(tmp_path / "missing.mcap"))
    assert none.returncode == 2
    assert "missing.mcap" in none.stderr


def test_a_recording_without_requests_is_not_good(tmp_path: Path) -> None:
    with virtual_cell("lab", record=tmp_path / "idle.mcap") as stack:
        stack.run_until_ready()
    result = replay(tmp_path / "idle.mcap")
    assert result.messages
    assert not result.good
    assert [line for line in notices(result) if line.startswith("nothing to compare")]


def test_a_message_that_fails_in_the_gate_is_a_difference(
    recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, when = Sim.take, iter(range(1000))

    def fails_once(sim: Sim, message: Message) -> list[ToTopic]:
        return take(sim, message) if next(when) != 40 else [][0]

    monkeypatch.setattr(Sim, "take", fails_once)
    found = replay(recorded)
    assert not found.good
    assert [line for line in map(str, found.differences) if "IndexError('list index out of range')" in line]
    assert found.memories  # it goes on from the next snapshot


def test_differences_are_found_in_lists_maps_and_the_sign_of_zero() -> None:
    was = {"a": [1.0, {"b": 0.0}], "c": None, "d": (1,)}
    now = {"a": [1.0, {"b": -0.0}], "c": 2, "d": (1, 2)}
    assert list(differing_fields(was, now)) == [
        ("a[1].b", 0.0, -0.0),
        ("c", None, 2),
        ("d", (1,), (1, 2)),
    ]
    assert list(differing_fields(was, was)) == []


@pytest.mark.nightly
def test_the_figure_of_a_recording_shows_both_robots_and_the_interventions_of_the_gate(
    recorded: Path, tmp_path: Path
) -> None:
    panels = panels_of(Recording.open(recorded))
    assert len(panels) == 3
    # before them the mode of RSI is probed, in less than a second
    assert 0 <= panels[0].lines[0].time_s[-1] - CYCLES * 0.012 < 1.0
    bound = sum(verdict.outcome != "admitted" for _, verdict in verdicts(recorded))
    assert sum(len(marks.time_s) for marks in panels[0].marks) == bound
    done = deltaq("recording", "plot", str(recorded), "--output", str(tmp_path / "figure.png"))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.nightly
def test_a_damaged_recording_gives_every_reader_at_most_one_line_of_error(
    recorded: Path, tmp_path: Path
) -> None:
    """Bytes of the file, and of messages whose checksum is then made anew, changed at random."""
    random = np.random.default_rng(11)
    damaged, identity = tmp_path / "damaged.mcap", Recording.open(recorded).about["identity"]
    readers: tuple[Callable[[Path], object], ...] = (
        replay,
        read_run,
        lambda file: panels_of(Recording.open(file)),
        lambda file: as_the_console_shows(file, identity),
    )

    def changed(data: bytes, count: int) -> bytes:
        bytes_of = bytearray(data)
        for place in random.integers(0, len(data), count) if data else ():
            some = [
                struct.pack("<d", random.choice([1e308, np.nan, -0.0, 5e-324])),
                b"\xff" * 8,
                b"\x00",
                b"",
            ]
            bytes_of[place : place + random.integers(1, 9)] = some[random.integers(0, len(some))]
        return bytes(bytes_of)

    for trial in range(400):
        if trial % 2:
            damaged.write_bytes(changed(recorded.read_bytes(), int(random.integers(1, 20))))
        else:
            rewrite(recorded, damaged, lambda _t, _n, data: changed(data, int(random.random() < 0.02)))
        for read in readers:
            with contextlib.suppress(DeltaqError):
                read(damaged)


class FailingOnce:
    """A gate that fails on one decision."""

    def __init__(self, gate: Decider, number: int) -> None:
        self._gate, self._left = gate, number

    def decide(self, robot: Tracker, others: Sequence[Tracker], request: Array) -> Decision:
        self._left -= 1
        if self._left == 0:
            raise ZeroDivisionError("nobody foresaw it")
        return self._gate.decide(robot, others, request)


def test_a_recorded_error_absent_in_the_replay_is_reported_and_the_replay_continues(
    tmp_path: Path,
) -> None:
    with virtual_cell("lab", record=tmp_path / "failed.mcap") as stack:
        stack.run_until_ready()
        stack.acquire("fr", "driver")
        stack.sim.gate = FailingOnce(stack.sim.gate, 10)
        for cycle in range(60):
            stack.cycle()
            stack.ask("fr", np.full(6, 1e-4))
            if cycle == 30:
                stack.reset("fr")
    assert stack.sim.counters["internal_errors"] == 1
    assert stack.sim.counters["admitted"] > 20
    told = replay(tmp_path / "failed.mcap")
    assert len({difference.number for difference in told.differences}) == 1
    assert "internal_error" in "".join(map(str, told.differences))
    assert (told.skipped, told.broken_receipts, told.gaps) == (0, [], [])
