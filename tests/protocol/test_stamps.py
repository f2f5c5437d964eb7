"""Stamps: a ring that forgets the oldest, a file that says what was lost, and nothing at all unless asked for."""

import sys
import threading
from pathlib import Path

import pytest
from ran import ran

from deltaq_protocol import stamps as module
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.stamps import FOLDER, Stamps, StampStation, read_stamps, stamps_if_asked


def filled(count: int, capacity: int) -> Stamps:
    stamps = Stamps("sim", ["fr", "gr"], capacity)
    for number in range(count):
        stamps.add(StampStation.DECIDED, "gr", number, 10 * number, time_ns=100 + number)
    return stamps


def test_no_stamps_are_written_without_the_environment_variable(monkeypatch: pytest.MonkeyPatch) -> None:
    for value in (None, ""):
        if value is None:
            monkeypatch.delenv(FOLDER, raising=False)
        else:
            monkeypatch.setenv(FOLDER, value)
        assert stamps_if_asked("sim", ["fr"]) is None


def test_a_full_ring_keeps_the_newest_in_order_and_counts_lost_stamps(tmp_path: Path) -> None:
    written = read_stamps(filled(7, capacity=4).write(tmp_path))
    assert written.overwritten == 3
    assert written.rows[:, 2].tolist() == [3, 4, 5, 6]
    assert written.rows[:, 4].tolist() == [103, 104, 105, 106]


@pytest.mark.parametrize("count", [0, 3, 4])
def test_a_ring_within_its_capacity_loses_nothing(tmp_path: Path, count: int) -> None:
    written = read_stamps(filled(count, capacity=4).write(tmp_path))
    assert (written.process, written.robots, written.overwritten) == ("sim", ("fr", "gr"), 0)
    assert written.rows.tolist() == [[StampStation.DECIDED, 1, n, 10 * n, 100 + n] for n in range(count)]


def test_an_unknown_robot_leaves_no_stamp(tmp_path: Path) -> None:
    stamps = Stamps("hli", ["fr"], 4)
    stamps.add(StampStation.INCREMENT_AT_HLI, "not-here", 1)
    assert len(read_stamps(stamps.write(tmp_path)).rows) == 0


def test_stamps_of_several_threads_do_not_overwrite_one_another(tmp_path: Path) -> None:
    stamps = Stamps("robot-server-fr", ["fr"], 8000)

    def work(first: int) -> None:
        for number in range(first, first + 2000):
            stamps.add(StampStation.STATE_OUT, "fr", number)

    threads = [threading.Thread(target=work, args=(2000 * number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(read_stamps(stamps.write(tmp_path)).rows[:, 2].tolist()) == list(range(8000))


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "has no header"),
        (b"\xff\xfe\n", "has no header"),
        (b"[1]\n", "has no header"),
        (b'{"process": "sim"}\n', "has no header"),
        (b'{"process": "sim", "robots": [], "kept": 2, "overwritten": 0}\n' + bytes(79), "79 bytes"),
    ],
)
def test_a_damaged_file_is_reported_by_name(tmp_path: Path, content: bytes, why: str) -> None:
    file = tmp_path / "sim-1.stamps"
    file.write_bytes(content)
    with pytest.raises(DeltaqError, match=why) as caught:
        read_stamps(file)
    assert str(file) in str(caught.value)


@pytest.mark.long
def test_a_stamping_process_writes_its_stamps_at_exit(tmp_path: Path) -> None:
    program = (
        f"from {module.__name__} import StampStation, stamps_if_asked\n"
        "one, same = (stamps_if_asked('sim', ['fr']) for _ in range(2))\n"
        "assert one is same\n"
        "one.add(StampStation.DECIDED, 'fr', 5, 6)\n"
        "raise SystemExit(3)\n"
    )
    done = ran(["env", f"{FOLDER}={tmp_path}", sys.executable, "-c", program], check=False)
    assert done.returncode == 3, done.stderr
    [file] = tmp_path.glob("*.stamps")
    assert read_stamps(file).rows[:, :4].tolist() == [[StampStation.DECIDED, 0, 5, 6]]
