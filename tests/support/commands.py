"""`deltaq` as a user types it, each time in a process of its own.

Most tests ask what a command prints and how it ends, and would wait for Python to import the same packages hundreds of
times. `deltaq` forks its process from one that has imported them, and nothing else; `PROGRAM` is the program itself.
"""

import multiprocessing
import os
import subprocess
import sys
from functools import cache
from multiprocessing.context import ForkServerContext
from pathlib import Path
from tempfile import TemporaryDirectory

PROGRAM = str(Path(sys.executable).with_name("deltaq"))
_IMPORTED = [
    "__main__",
    "deltaq_deploy.command.app",
    "deltaq_deploy.command.console",
    "deltaq_cell.cell_model",
]


def deltaq(
    *arguments: str, environment: dict[str, str] | None = None, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run `deltaq` with these arguments, without a terminal, and wait for its end.

    Args:
        arguments: as they are typed.
        environment: variables; those of the tests if not given.
        folder: to run in; that of the tests if not given.
    """
    with TemporaryDirectory() as kept:
        files = [Path(kept) / name for name in ("stdout", "stderr")]
        process = _context().Process(
            target=_run,
            args=(arguments, environment or dict(os.environ), folder or Path.cwd(), files),
        )
        process.start()
        process.join()
        assert process.exitcode is not None  # it was joined
        out, err = (file.read_text(encoding="utf-8") for file in files)
        return subprocess.CompletedProcess([PROGRAM, *arguments], process.exitcode, out, err)


@cache
def _context() -> ForkServerContext:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_IMPORTED)
    return context


def _run(arguments: tuple[str, ...], environment: dict[str, str], folder: Path, files: list[Path]) -> None:
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    nowhere = os.open(os.devnull, os.O_RDONLY)
    for number, file in (
        (0, nowhere),
        *enumerate((os.open(file, os.O_WRONLY | os.O_CREAT) for file in files), 1),
    ):
        os.dup2(file, number)
    for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 # for the life of the process
    sys.argv = [PROGRAM, *arguments]
    from deltaq_deploy.command import main

    main()
