"""The file of the audit log: a disk that fails first."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from deltaq_services.hli.audit import AuditFile, AuditFileError, default_audit_file, older


def line(number: int) -> bytes:
    return b'{"number":%04d}\n' % number


def written(path: Path, numbers: range, **bounds: int) -> AuditFile:
    """A closed file to which these lines were written."""
    file = AuditFile(path, **bounds)
    for number in numbers:
        file.write(line(number))
    file.close()
    return file


def test_a_full_disk_loses_lines_counts_them_and_says_why() -> None:
    file = written(Path("/dev/full"), range(50))
    assert file.lost == 50
    assert file.fault == os.strerror(28)


def test_a_pipe_that_nobody_reads_keeps_nobody_waiting(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    file = AuditFile(pipe)
    for _ in range(3000):
        file.write(b"x" * 99 + b"\n")
    file.close()  # a pipe holds 64 KiB
    assert 3000 - 64 * 1024 // 100 - 1 <= file.lost < 3000


def test_a_folder_that_went_loses_lines_until_it_is_back(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    folder.mkdir()
    path = folder / "audit.jsonl"
    file = AuditFile(path)
    path.unlink()
    folder.rmdir()
    file.write(line(1))
    while not file.lost:
        pass
    assert "No such file" in file.fault
    folder.mkdir()
    file.write(line(2))
    file.close()
    assert (path.read_bytes(), file.lost, file.fault) == (line(2), 1, "")


@pytest.mark.parametrize("torn", [b'{"numb', b'{"number":0001}', b'{"number":0001}\n{"nu'])
def test_a_line_that_a_crash_tore_is_ended_and_none_before_it_is_touched(tmp_path: Path, torn: bytes) -> None:
    path = tmp_path / "audit.jsonl"
    path.touch(0o600)
    path.write_bytes(torn)
    written(path, range(2, 4))
    assert path.read_bytes() == torn + b"\n" + line(2) + line(3)


def test_rotation_keeps_the_newest_and_no_more_than_it_may(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    written(path, range(100), most_bytes=160, most_files=3)
    files = [path, *older(path, 3)]
    assert sorted(tmp_path.iterdir()) == sorted(files)
    assert all(0 < file.stat().st_size <= 160 for file in files)
    kept = b"".join(file.read_bytes() for file in reversed(files))
    assert kept == b"".join(line(number) for number in range(70, 100))


def test_one_file_alone_is_bounded_too(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    written(path, range(25), most_bytes=160, most_files=1)
    assert path.read_bytes() == b"".join(line(number) for number in range(20, 25))
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_somebody_moved_away_is_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    written(path, range(1))
    file = AuditFile(path)
    path.rename(tmp_path / "moved")
    file.write(line(1))
    file.close()
    assert (path.read_bytes(), (tmp_path / "moved").read_bytes()) == (line(1), line(0))


def test_it_is_its_owners_alone_whatever_the_mask(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    before = os.umask(0)
    try:
        written(path, range(30), most_bytes=160, most_files=2)
    finally:
        os.umask(before)
    assert {stat.S_IMODE(file.stat().st_mode) for file in tmp_path.iterdir()} == {0o600}


def test_one_that_others_may_read_or_that_cannot_be_opened_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "audit.jsonl"
    path.touch()
    path.chmod(0o644)
    with pytest.raises(AuditFileError, match=r"audit\.jsonl has mode 0644 .* `chmod 600 "):
        AuditFile(path)
    with pytest.raises(AuditFileError, match=r"nowhere/x cannot be written: No such file"):
        AuditFile(tmp_path / "nowhere" / "x")


def test_by_default_it_is_with_the_users_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert default_audit_file("lab") == tmp_path / "state" / "deltaq" / "audit-lab.jsonl"
    assert stat.S_IMODE((tmp_path / "state" / "deltaq").stat().st_mode) == 0o700
    monkeypatch.setenv("XDG_STATE_HOME", "/proc/nowhere")
    with pytest.raises(AuditFileError, match="/proc/nowhere/deltaq cannot be made"):
        default_audit_file("lab")
