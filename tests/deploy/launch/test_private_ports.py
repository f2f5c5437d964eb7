"""The folder in which processes claim ports: nobody else's, and no way to files elsewhere."""

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltaq_protocol.errors import DeltaqError
from deltaq_testing import private_cell


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    private_cell._claims.cache_clear()
    yield tmp_path / f"deltaq-ports-{os.geteuid()}"
    private_cell._claims.cache_clear()


def claim() -> None:
    lock = private_cell._claims(private_cell.FIRST_PORT)
    assert lock is not None
    os.close(lock)


def test_a_claim_lies_in_a_private_folder_of_the_user(folder: Path) -> None:
    claim()
    assert folder.stat().st_mode & 0o777 == 0o700


@pytest.mark.parametrize("what", ["a link", "writable by all", "a file"])
def test_a_folder_of_another_user_is_refused(folder: Path, tmp_path: Path, what: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    if what == "a link":
        folder.symlink_to(elsewhere)
    elif what == "a file":
        folder.touch()
    else:
        folder.mkdir()
        folder.chmod(0o777)
    with pytest.raises(DeltaqError, match="remove it"):
        claim()
    assert not list(elsewhere.iterdir())


def test_a_symbolic_link_in_the_folder_is_not_followed(folder: Path, tmp_path: Path) -> None:
    folder.mkdir(mode=0o700)
    (folder / str(private_cell.FIRST_PORT)).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="symbolic"):
        claim()
    assert not (tmp_path / "elsewhere").exists()
