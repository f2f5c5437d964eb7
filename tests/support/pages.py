"""Runs what a page of the documents shows, as a reader would who does nothing else.

A comment before a fenced block says what a reader does with it:

    <!-- run: sh -->             type it, or `python`; it has to end with status 0
    <!-- nightly: sh -->         the same, but it takes long: only `make nightly` does it
    <!-- background: TEXT -->    type it in a terminal of its own, and go on once it has printed TEXT
    <!-- Ctrl-C -->              (by itself) end what runs in the terminal that was opened last; so does the page's end
    <!-- write: NAME -->         save it as this file
    <!-- prints -->              see these lines in what the command before printed
    <!-- not run: REASON -->     nothing here

Everything happens in one empty folder: `python pages.py PAGE FOLDER [--nightly]`.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

TESTED_LANGUAGES = {"sh", "python", "yaml", "json", "matlab", "text"}
KINDS = {"run", "nightly", "background", "Ctrl-C", "write", "prints", "not run"}
STARTS_WITHIN_S = 600.0
ENDS_WITHIN_S = 600.0
RUNS_WITHIN_S = 600.0

_STEP = re.compile(
    r"(?:^<!-- (?P<kind>[A-Za-z -]+?)(?:: (?P<argument>[^\n]*?))? -->\n)?"
    r"^```(?P<language>\w*)\n(?P<text>.*?)^```$"
    r"|^<!-- (?P<alone>Ctrl-C) -->$",
    re.MULTILINE | re.DOTALL,
)


class PageError(Exception):
    """What a page shows is not what happens."""


@dataclass(frozen=True)
class Step:
    """One block of a page.

    Attributes:
        line: of the page, from 1.
        kind: one of `KINDS`; empty if nothing is said about the block.
        argument: what stands behind the kind.
        language: of the block.
        text: of the block.
    """

    line: int
    kind: str
    argument: str
    language: str
    text: str


def steps(page: str) -> Iterator[Step]:
    """The blocks of a page, in order.

    Raises:
        PageError: for a comment that says nothing that is known.
    """
    for match in _STEP.finditer(page):
        kind = match["kind"] or match["alone"] or ""
        line = page.count("\n", 0, match.start()) + 1
        if kind and kind not in KINDS:
            raise PageError(f"line {line}: {kind!r} is none of {', '.join(sorted(KINDS))}")
        yield Step(line, kind, match["argument"] or "", match["language"] or "", match["text"] or "")


class Terminal:
    """A command that runs until Ctrl-C."""

    def __init__(self, step: Step, folder: Path) -> None:
        self._step = step
        self._lines: list[str] = []
        self._seen = threading.Event()
        self._process = subprocess.Popen(
            ["bash", "-euc", step.text],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            text=True,
        )
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def wait_until_seen(self) -> None:
        """Until it has printed what the page says."""
        seen = self._seen.wait(STARTS_WITHIN_S)
        if not seen or not any(self._step.argument in line for line in self._lines):
            raise PageError(
                f"line {self._step.line}: {self._step.argument!r} was never printed, but\n{self._said()}"
            )

    def interrupt(self) -> None:
        """Ctrl-C, as a terminal sends it: to all that runs there."""
        self._signal(signal.SIGINT)
        try:
            status = self._process.wait(ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            raise PageError(f"line {self._step.line}: goes on after Ctrl-C\n{self._said()}") from None
        self._reader.join()
        if status:
            raise PageError(f"line {self._step.line}: status {status} after Ctrl-C\n{self._said()}")

    def kill(self) -> None:
        """Leave nothing of it."""
        self._signal(signal.SIGKILL)
        self._process.wait()
        self._reader.join()

    def _read(self) -> None:
        assert self._process.stdout is not None  # a pipe was asked for
        with self._process.stdout as output:
            for line in output:
                self._lines.append(line)
                if self._step.argument in line:
                    self._seen.set()
        self._seen.set()  # nothing more will come

    def _signal(self, number: signal.Signals) -> None:
        with suppress(ProcessLookupError):  # it has ended
            os.killpg(self._process.pid, number)

    def _said(self) -> str:
        return "".join(self._lines)


class Reader:
    """Does what a page says, in one folder.

    Args:
        folder: empty, and the working directory of all commands.
        patient: does what takes long, too.
    """

    def __init__(self, folder: Path, patient: bool = False) -> None:
        self._folder = folder
        self._patient = patient
        self._terminals: list[Terminal] = []
        self._printed = ""

    def read(self, page: str) -> None:
        """Do all of it.

        Raises:
            PageError: where the page is wrong.
        """
        try:
            for step in steps(page):
                self._do(step)
            while self._terminals:
                self._terminals.pop().interrupt()
        finally:
            for terminal in self._terminals:
                terminal.kill()

    def _do(self, step: Step) -> None:
        match step.kind:
            case "run":
                self._run(step)
            case "nightly" if self._patient:
                self._run(step)
            case "background":
                self._terminals.append(Terminal(step, self._folder))
                self._terminals[-1].wait_until_seen()
            case "Ctrl-C":
                self._terminals[-1].interrupt()
                del self._terminals[-1]
            case "write":
                (self._folder / step.argument).write_text(step.text, encoding="utf-8")
            case "prints":
                self._compare(step)

    def _run(self, step: Step) -> None:
        command = ["python", "-"] if step.argument == "python" else ["bash", "-euo", "pipefail"]
        with subprocess.Popen(
            command,
            cwd=self._folder,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            text=True,
        ) as running:
            try:
                self._printed, _ = running.communicate(step.text, RUNS_WITHIN_S)
            except BaseException:
                os.killpg(running.pid, signal.SIGKILL)  # with what it started
                raise
        print(f"line {step.line}: status {running.returncode}", flush=True)
        if running.returncode:
            raise PageError(f"line {step.line}: status {running.returncode}\n{step.text}{self._printed}")

    def _compare(self, step: Step) -> None:
        rest = self._printed
        for line in step.text.splitlines():
            _, found, rest = rest.partition(line.strip())
            if not found and line.strip():
                raise PageError(f"line {step.line}: {line!r} was not printed, but\n{self._printed}")


def main() -> int:
    """Read one page; returns 1, with the reason, if it is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("page", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--nightly", action="store_true")
    options = parser.parse_args()
    try:
        Reader(options.folder, options.nightly).read(options.page.read_text(encoding="utf-8"))
    except PageError as error:
        print(f"{options.page.name}, {error}")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
