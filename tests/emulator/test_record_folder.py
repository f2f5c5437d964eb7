"""What a stranger at the emulator's panel can have written: new files of the one folder, and nothing else."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from krc_bench import Bench

from deltaq_emulator import recorder as record_folder
from deltaq_emulator.faults import FaultyLink
from deltaq_emulator.panel import Panel
from deltaq_emulator.recorder import CsvRecorder, RecordError, RecordFolder
from deltaq_testing.private_cell import free_ports, write_private_cell


class Asked:
    """A panel whose records go into `folder`, and the recorder behind it."""

    def __init__(self, folder: Path) -> None:
        self.bench = Bench()
        self.recorder = CsvRecorder(0.012, self.bench.n, RecordFolder(folder))
        self.panel = Panel("fr", self.bench.krc, FaultyLink(1), FaultyLink(2), self.recorder)

    def record(self, path: str | None) -> dict[str, Any]:
        told: list[dict[str, Any]] = []
        request = {"op": "record", "path": path}
        self.panel.take(json.dumps(request).encode(), lambda answer: told.append(json.loads(answer)))
        (answer,) = told
        return answer


@contextmanager
def asking(folder: Path) -> Iterator[Asked]:
    asked = Asked(folder)
    try:
        yield asked
    finally:
        asked.recorder.stop()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "records"
    folder.mkdir()
    return folder


def everything(below: Path) -> dict[Path, bytes | None]:
    return {file: file.read_bytes() if file.is_file() else None for file in below.rglob("*")}


@pytest.mark.parametrize(
    "path",
    [
        "/etc/cron.d/evil",
        "../evil.csv",
        "..",
        ".",
        "",
        ".hidden",
        "sub/evil.csv",
        "sub/../../evil.csv",
        "./evil.csv",
        "evil\n.csv",
        "evil\x00.csv",
        "ev\u0131l.csv",
        "evil.csv ",
        "a" * 101,
    ],
)
def test_what_is_no_plain_name_is_refused_and_nothing_is_written(folder: Path, path: str) -> None:
    (folder / "sub").mkdir()
    before = everything(folder.parent)
    answer = Asked(folder).record(path)
    assert answer["ok"] is False
    assert "is no name of a file" in answer["error"]
    assert str(folder) in answer["error"]
    assert everything(folder.parent) == before


def test_an_absolute_path_below_the_folder_is_refused_too(folder: Path) -> None:
    assert "without a folder" in Asked(folder).record(str(folder / "run.csv"))["error"]


@pytest.mark.parametrize("target", ["victim.txt", "not-there.txt"])
def test_a_link_is_not_followed(folder: Path, target: str) -> None:
    victim = folder.parent / "victim.txt"
    victim.write_text("precious")
    (folder / "run.csv").symlink_to(folder.parent / target)
    assert "exists already" in Asked(folder).record("run.csv")["error"]
    assert victim.read_text() == "precious"
    assert not (folder.parent / "not-there.txt").exists()


def test_neither_a_file_nor_a_pipe_that_is_there_is_written_over(folder: Path) -> None:
    (folder / "run.csv").write_text("precious")
    os.mkfifo(folder / "pipe")  # whose opening would wait for a reader
    asked = Asked(folder)
    for name in ("run.csv", "pipe"):
        assert "exists already" in asked.record(name)["error"]
    assert (folder / "run.csv").read_text() == "precious"


def test_a_refused_record_leaves_the_one_that_is_being_written(folder: Path) -> None:
    with asking(folder) as asked:
        assert asked.record("run.csv")["record"] == str(folder / "run.csv")
        assert asked.record("../evil.csv")["ok"] is False
        assert asked.recorder.path == folder / "run.csv"


def test_a_folder_that_a_link_stands_for_is_refused(folder: Path) -> None:
    link = folder.parent / "link"
    link.symlink_to(folder)
    for path in (link, folder / "none", Path(__file__)):
        with pytest.raises(RecordError, match=r"--records .*: is no folder"):
            RecordFolder(path)


def test_a_folder_that_is_swapped_for_a_link_later_changes_nothing(folder: Path) -> None:
    elsewhere = folder.parent / "elsewhere"
    elsewhere.mkdir()
    with asking(folder) as asked:
        folder.rename(folder.parent / "moved")
        folder.symlink_to(elsewhere)
        assert asked.record("run.csv")["ok"] is True
    assert not list(elsewhere.iterdir())
    assert (folder.parent / "moved" / "run.csv").exists()


def test_there_is_an_end_to_files_and_to_rows(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_folder, "MOST_RECORDS", 2)
    monkeypatch.setattr("deltaq_emulator.recorder.MOST_ROWS", 3)
    with asking(folder) as asked:
        asked.record("a.csv")
        for _ in range(5):
            asked.recorder.row(asked.bench.krc.sample)
        assert len((folder / "a.csv").read_text().splitlines()) == 1 + 3
        assert asked.recorder.error is not None
        assert "no more are allowed" in asked.recorder.error
        assert asked.record("b.csv")["ok"] is True
        assert "2 records were begun" in asked.record("c.csv")["error"]


@pytest.mark.service
def test_a_stranger_at_a_running_emulators_socket_writes_nowhere_else(tmp_path: Path) -> None:
    folder = tmp_path / "records"
    folder.mkdir()
    (panel,) = free_ports(1)
    cell = str(write_private_cell(tmp_path))
    command = [sys.executable, "-m", "deltaq_emulator", "--cell", cell, "--robot", "fr"]
    command += ["--records", str(folder), "--panel", f"127.0.0.1:{panel}"]
    with (
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as emulator,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        try:
            assert emulator.stdout is not None
            assert emulator.stdout.readline().startswith("ready: ")
            stranger.settimeout(300)
            stranger.connect(("127.0.0.1", panel))

            def record(path: str) -> dict[str, Any]:
                stranger.send(json.dumps({"op": "record", "path": path}).encode())
                return dict(json.loads(stranger.recv(65536)))

            for path in (str(tmp_path / "evil.csv"), "../evil.csv"):
                assert "is no name of a file" in record(path)["error"]
            assert record("run.csv")["record"] == str(folder / "run.csv")
        finally:
            emulator.terminate()
    assert not list(tmp_path.glob("evil*"))
    assert [file.name for file in folder.iterdir()] == ["run.csv"]
