"""Ctrl-C while a command still loads its modules: no traceback, and the status that shells give to Ctrl-C."""

import os
import subprocess
from pathlib import Path

import pytest
from commands import PROGRAM
from ran import ran

# comes as sitecustomize: the interpreter loads it before the command
INTERRUPTS_ITSELF = """
import os, signal, sys

class Finder:
    at = os.environ.pop("INTERRUPTED_AT", None)  # processes that it starts are none of ours

    def find_spec(self, name, path=None, target=None):
        if name == self.at:
            self.at = None
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Finder())
"""

BY_EVERY_VERB = ("typer", "numpy", "zenoh", "pydantic")
BY_ONE = [
    ("yaml", "up"),
    ("yaml", "demo"),
    ("yaml", "check"),
    ("yaml", "doctor"),
    ("yaml", "recording record --output never-written.mcap"),
    ("yaml", "drive --robot fr"),
    ("yaml", "dry-run --robot fr --dq 0,0,0,0,0,0"),
    ("yaml", "contact"),
    ("yaml", "status --service sim"),
    ("yaml", "fault inject krc-hiccup --robot fr"),
    ("numba", "experiment tracking --duration-s 1"),
    ("pinocchio", "experiment attack --duration-s 1"),
    ("pinocchio", "advise --offline"),
    ("pinocchio", "experiment peg-and-valve"),
    ("pinocchio", "bench"),
    ("asyncio", "fault impair --listen tcp/127.0.0.1:9 --to tcp/127.0.0.1:9"),
    ("deltaq_testing.replay", "recording replay never-written.mcap"),
    ("mcap", "recording plot never-written.mcap"),
]


@pytest.mark.by_day(5)
@pytest.mark.long
@pytest.mark.parametrize(
    ("module", "words"), [*((module, "status") for module in BY_EVERY_VERB), *BY_ONE], ids=lambda text: text
)
def test_ctrl_c_during_imports_ends_silently(tmp_path: Path, module: str, words: str) -> None:
    (tmp_path / "sitecustomize.py").write_text(INTERRUPTS_ITSELF)
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = ran(
        [PROGRAM, *words.split()],
        env=os.environ | {"PYTHONPATH": path, "INTERRUPTED_AT": module},
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
