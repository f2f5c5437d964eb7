from pathlib import Path

import pytest
import typer

from deltaq_deploy.command.drive import loaded


@pytest.fixture
def file(tmp_path: Path) -> Path:
    beside = tmp_path / "beside.py"
    beside.write_text("STEP = [0.001]\n")
    file = tmp_path / "turn.py"
    file.write_text(
        "from beside import STEP\n"
        "class Turn:\n    def increment(self, view):\n        return STEP\n"
        "ready = Turn()\nnothing = 3\n"
    )
    return file


@pytest.mark.parametrize("name", ["Turn", "ready"])
def test_a_class_or_an_object_of_a_file_is_a_controller(file: Path, name: str) -> None:
    assert loaded(f"{file}:{name}").increment(None) == [0.001]


@pytest.mark.parametrize(
    ("named", "told"),
    [
        ("turn.py", "'turn.py' is not FILE.py:NAME"),
        ("turn.txt:Turn", "'turn.txt:Turn' is not FILE.py:NAME"),
        ("nosuch.py:Turn", "there is no file nosuch.py"),
        ("{file}:Trun", "has no Trun; with `increment` it has: Turn, ready"),
        ("{file}:nothing", "has no method increment"),
    ],
)
def test_an_unknown_controller_is_refused_with_the_known_ones(file: Path, named: str, told: str) -> None:
    with pytest.raises(typer.BadParameter, match=told):
        loaded(named.format(file=file))
