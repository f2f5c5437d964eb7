"""Programs end without a traceback: a user's mistake, Ctrl-C, and a reader of the output that has left."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deltaq_deploy.launch import BAD, DONE, INTERRUPTED, USAGE

ROOT = Path(__file__).parents[3]
PROGRAMS = sorted(
    file
    for folder in ("experiments", "tests/proofs")
    for file in (ROOT / folder).rglob("*.py")
    if re.search(r"ArgumentParser\((.|\n)*if __name__ ==", file.read_text(encoding="utf-8"))
)


def ended(*command: str, stdout: int = subprocess.PIPE) -> tuple[int, str]:
    """Exit status and standard error of a program of Python's."""
    # what is printed waits in a buffer, as it does for a user: it is written when the program has already ended
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(
        [sys.executable, *command],
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        env=buffered,
    )
    return done.returncode, done.stderr


@pytest.mark.parametrize("file", PROGRAMS, ids=lambda file: file.relative_to(ROOT).as_posix())
def test_each_user_program_ends_through_run_program(file: Path) -> None:
    # what others start, with positions for arguments, is no user's
    assert "    run_program(main, " in file.read_text(encoding="utf-8")


@pytest.mark.by_day(3)
@pytest.mark.parametrize(
    ("command", "told"),
    [
        (["studies.conservatism", "--cell", "nosuch"], "nosuch: no cell of that name"),
        (["studies.directions", "--mode", "nosuch"], "invalid choice: 'nosuch'"),
        (["studies.claims", "--only", "nosuch"], "--only 'nosuch': no claim has this"),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, list) else "",
)
def test_a_user_error_gives_one_line(command: list[str], told: str) -> None:
    status, errors = ended("-m", *command)
    assert status == USAGE
    assert told in errors.splitlines()[-1]
    assert "Traceback" not in errors


@pytest.mark.by_day(1)
@pytest.mark.parametrize(
    ("command", "status"),
    [
        (["-m", "deltaq_proofs.model_checker", "--cycles", "1", "--json"], DONE),
        (["-c", "from deltaq_deploy.command import main; main()", "--version"], BAD),  # click's choice
    ],
    ids=["program", "command"],
)
def test_a_closed_pipe_is_no_error(command: list[str], status: int) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    try:
        assert ended(*command, stdout=writer) == (status, "")
    finally:
        os.close(writer)


def test_ctrl_c_is_no_error_either() -> None:
    program = (
        "import signal, sys; from deltaq_deploy.launch.program import run_program\n"
        "def main():\n"
        "    print('here', flush=True); signal.pause()\n"
        "run_program(main, 'program')"
    )
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", program], text=True, **pipes) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == "here\n"
        process.send_signal(signal.SIGINT)
        assert (process.wait(), process.stderr.read()) == (INTERRUPTED, "")
