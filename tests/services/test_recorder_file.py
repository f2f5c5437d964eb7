"""What the recorder writes, and what of it can be read when it was cut off or damaged."""

import os
import signal
import struct
import threading
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from rewritten import rewrite

from deltaq_cell.cell_model import CellModel
from deltaq_protocol import topics
from deltaq_protocol.messages import Description, Phase, RobotState
from deltaq_services.process import HeldInterrupts
from deltaq_services.recorder.protobuf import recorded_schema
from deltaq_services.recorder.reader import Recording, UnreadableRecordingError
from deltaq_services.recorder.writer import RecordingError, RecordingWriter

CYCLE_NS = 12_000_000
STATES = 400


@pytest.fixture(scope="module")
def cell() -> CellModel:
    return CellModel.load("lab")


@pytest.fixture(scope="module")
def description(cell: CellModel) -> Description:
    return cell.description_message()


def state(cell: CellModel, cycle: int) -> RobotState:
    # joints that look random, so that chunks do not shrink to nothing
    robot = cell.robots["fr"]
    q = robot.home + 0.1 * np.sin(np.arange(6) + 1.7 * cycle)
    return RobotState(
        robot="fr",
        cycle=cycle,
        ipoc=12 * cycle,
        time_s=0.012 * cycle,
        q=tuple(q.tolist()),
        q_cmd=tuple(q.tolist()),
        tool=robot.tool_pose(q),
        phase=Phase.READY,
    )


def write(path: Path, cell: CellModel, count: int = STATES) -> Path:
    with RecordingWriter(path, cell.description_message(), "virtual time") as writer:
        for cycle in range(count):
            writer.publish(topics.STATE, state(cell, cycle), cycle * CYCLE_NS)
    return path


@pytest.fixture(scope="module")
def recorded(cell: CellModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("recorded") / "run.mcap", cell)


def cycles(recording: Recording) -> list[int]:
    return [item.message.cycle for item in recording.messages()]


def test_an_existing_file_is_never_overwritten(tmp_path: Path, description: Description) -> None:
    file = tmp_path / "run.mcap"
    file.write_text("something dear")
    with pytest.raises(RecordingError, match="name another file"):
        RecordingWriter(file, description, "live")
    assert file.read_text() == "something dear"


def test_a_missing_folder_is_reported(tmp_path: Path, description: Description) -> None:
    with pytest.raises(RecordingError, match="No such file"):
        RecordingWriter(tmp_path / "nowhere" / "run.mcap", description, "live")


def test_a_full_disk_is_reported_and_ends_the_recording(cell: CellModel) -> None:
    with pytest.raises(RecordingError, match=r"/dev/full can no longer be written: No space left"):
        write(Path("/dev/full"), cell)


def test_written_messages_are_read_in_order(recorded: Path, cell: CellModel) -> None:
    recording = Recording.open(recorded)
    read = list(recording.messages())
    assert [item.message for item in read] == [state(cell, cycle) for cycle in range(STATES)]
    assert read[7].time_ns == 7 * CYCLE_NS
    assert recording.about["cell"] == "lab"
    assert recording.robots == ("fr", "gr")
    assert recording.notices == []


def test_the_cell_is_modelled_from_the_recording_alone(recorded: Path, cell: CellModel) -> None:
    model = Recording.open(recorded).cell()
    assert model.description == cell.description
    np.testing.assert_array_equal(
        model.robots["gr"].forward(model.robots["gr"].home), cell.robots["gr"].forward(cell.robots["gr"].home)
    )


def test_a_file_other_than_a_recording_is_reported(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("not a recording")
    for path in (file, tmp_path / "missing.mcap"):
        with pytest.raises(UnreadableRecordingError, match=path.name):
            Recording.open(path)


def test_a_truncated_file_is_read_up_to_its_end(recorded: Path, tmp_path: Path) -> None:
    data, cut = recorded.read_bytes(), tmp_path / "cut.mcap"
    lengths = []
    for share in (0.5, 0.7, 0.9):
        cut.write_bytes(data[: int(len(data) * share)])
        recording = Recording.open(cut)
        read = cycles(recording)
        assert read == list(range(len(read)))
        assert len(recording.notices) == 1
        assert "was read as far as it goes" in recording.notices[0] or "left out" in recording.notices[0]
        lengths.append(len(read))
    assert lengths == sorted(lengths)


def test_a_file_cut_off_in_its_beginning_is_no_recording(recorded: Path, tmp_path: Path) -> None:
    data, cut = recorded.read_bytes(), tmp_path / "cut.mcap"
    for length in (0, 4, 8, 100, 3000):
        cut.write_bytes(data[:length])
        with pytest.raises(UnreadableRecordingError):
            Recording.open(cut)


def with_chunk(recorded: Path, claimed: int, packed: bytes) -> bytes:
    """The recording's bytes with one more chunk, before its first."""
    body = struct.pack("<QQQI", 0, 0, claimed, 0) + struct.pack("<I", 4) + b"zstd"
    body += struct.pack("<Q", len(packed)) + packed
    with recorded.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    place, data = summary.chunk_indexes[0].chunk_start_offset, recorded.read_bytes()
    return data[:place] + bytes([Opcode.CHUNK]) + struct.pack("<Q", len(body)) + body + data[place:]


@pytest.mark.parametrize(
    ("claimed", "says"), [(3 << 30, "claims 3221225472 bytes unpacked, and at most"), (100, "and has more")]
)
def test_a_chunk_is_never_unpacked_beyond_its_bound(
    recorded: Path, tmp_path: Path, claimed: int, says: str
) -> None:
    zeros = zstandard.ZstdCompressor().compressobj()
    packed = b"".join(zeros.compress(bytes(1 << 20)) for _ in range(512)) + zeros.flush()
    bomb = tmp_path / "bomb.mcap"
    bomb.write_bytes(with_chunk(recorded, claimed, packed))
    recording = Recording.open(bomb)
    tracemalloc.start()
    try:
        assert cycles(recording) == list(range(STATES))
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    assert says in recording.notices[0]


@pytest.mark.parametrize("missing", ["robots", "cell"])
def test_a_missing_metadata_entry_is_reported_by_name(recorded: Path, tmp_path: Path, missing: str) -> None:
    file = tmp_path / "run.mcap"
    rewrite(recorded, file, about=lambda entries: {k: v for k, v in entries.items() if k != missing})
    with pytest.raises(UnreadableRecordingError, match=f"its metadata 'deltaq' has no '{missing}'"):
        Recording.open(file)


def test_a_robot_without_urdf_is_reported_by_name(recorded: Path, tmp_path: Path) -> None:
    file = rewrite(recorded, tmp_path / "run.mcap", about=lambda entries: {**entries, "robots": "gr"})
    file = rewrite(file, tmp_path / "less.mcap", without=["fr.urdf"])
    with pytest.raises(UnreadableRecordingError, match="it has no URDF of fr"):
        Recording.open(file).cell()


def test_a_value_outside_of_its_schema_loses_only_its_message(recorded: Path, tmp_path: Path) -> None:
    def unknown_phase(topic: str, number: int, data: bytes) -> bytes:
        del number
        if not topic.endswith("/state"):
            return data
        encoded = recorded_schema().classes[RobotState].FromString(data)
        if encoded.cycle == 7:
            encoded.phase = 99
        return bytes(encoded.SerializeToString())

    recording = Recording.open(rewrite(recorded, tmp_path / "run.mcap", unknown_phase))
    assert cycles(recording) == [cycle for cycle in range(STATES) if cycle != 7]
    assert recording.notices == ["messages left out because they are not of this version: 1"]


@pytest.mark.long
def test_every_single_damaged_byte_is_survived(recorded: Path, tmp_path: Path) -> None:
    data, damaged = recorded.read_bytes(), tmp_path / "damaged.mcap"
    random = np.random.default_rng(5)
    for place in random.integers(0, len(data), 60).tolist():
        changed = bytearray(data)
        changed[place] ^= 0xFF
        damaged.write_bytes(changed)
        try:
            read = cycles(Recording.open(damaged))
        except UnreadableRecordingError:
            continue  # the damage is in what a recording begins with
        assert set(read) <= set(range(STATES))


@pytest.mark.long
def test_a_damaged_chunk_is_omitted_and_the_others_are_read(cell: CellModel, tmp_path: Path) -> None:
    file = write(tmp_path / "run.mcap", cell, 1500)
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert len(summary.chunk_indexes) >= 3
    # the first chunk holds the schemas and channels of all the others
    first, second = summary.chunk_indexes[0], summary.chunk_indexes[1]
    data = bytearray(file.read_bytes())
    data[first.chunk_start_offset + first.chunk_length // 2] ^= 0xFF
    file.write_bytes(data)
    recording = Recording.open(file)
    read = cycles(recording)
    assert read == list(range(read[0], 1500))
    assert 0 < read[0] * CYCLE_NS <= second.message_start_time + CYCLE_NS
    assert ["damaged and was left out" in notice for notice in recording.notices] == [True]


def test_other_programs_read_joint_states_and_transforms(recorded: Path, cell: CellModel) -> None:
    robot, seen = cell.robots["fr"], set()
    with recorded.open("rb") as stream:
        for schema, channel, message, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            seen.add((channel.topic, schema.name))
            cycle = message.log_time // CYCLE_NS
            if schema.name == "foxglove.JointStates":
                joints = {joint.name: joint.position for joint in decoded.joints}
                assert tuple(joints) == robot.joint_names
                assert tuple(joints.values()) == state(cell, cycle).q
            elif schema.name == "foxglove.FrameTransforms":
                frames = {item.child_frame_id: item for item in decoded.transforms}
                assert {item.parent_frame_id for item in decoded.transforms} == {"world"}
                at = frames["fr/link_2"].translation
                np.testing.assert_allclose(
                    (at.x, at.y, at.z), robot.joint_origins(state(cell, cycle).q)[1], atol=1e-12
                )
    assert seen == {
        ("deltaq/lab/fr/state", "deltaq.RobotState"),
        ("/fr/joint_states", "foxglove.JointStates"),
        ("/tf", "foxglove.FrameTransforms"),
    }


# What must not be cut in two is not: a signal waits until it is let go.


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_held_signal_waits_for_its_release(number):
    before = signal.getsignal(number)
    with HeldInterrupts() as held:
        held.let_go()
        os.kill(os.getpid(), number)
        all_of_it = True
        with pytest.raises(KeyboardInterrupt):
            held.let_go()
    assert all_of_it
    assert signal.getsignal(number) is before


def test_in_another_thread_holding_signals_does_nothing():
    before, ended = signal.getsignal(signal.SIGINT), []

    def hold():
        with HeldInterrupts() as held:
            held.let_go()
        ended.append(True)

    thread = threading.Thread(target=hold)
    thread.start()
    thread.join(timeout=300)
    assert ended == [True]
    assert signal.getsignal(signal.SIGINT) is before
