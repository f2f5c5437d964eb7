"""The clients in other languages, each with the command that runs a program of its own."""

import functools
import os
import shutil
import subprocess
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path

import octave

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / "clients"
PROGRAMS = ROOT / "tests" / "clients" / "programs"


class Language(ABC):
    """A language, and how a program in it is started."""

    name: str
    sources: tuple[Path, ...]
    """Where the client and its example name fields of messages."""

    @abstractmethod
    def why_not(self) -> str:
        """Why programs cannot run here; empty if they can."""

    @abstractmethod
    def turn_a1(self, port: int) -> list[str]:
        """The example."""

    @abstractmethod
    def answers(self, port: int, robot: str, compute_s: float, count: int) -> list[str]:
        """The program that answers states, each after computing."""

    @abstractmethod
    def far_turn(self, port: int, angle: float) -> list[str]:
        """The program that turns A1 by an angle [rad] from farther away than a cycle."""

    def environment(self, **variables: str) -> dict[str, str]:
        """Of its programs: without a token that the tests' own environment may have."""
        return {
            name: value for name, value in os.environ.items() if not name.startswith("DELTAQ_")
        } | variables


class Octave(Language):
    """And so MATLAB, as far as the two agree."""

    name = "octave"
    sources = (
        CLIENTS / "matlab/+deltaq/Client.m",
        CLIENTS / "matlab/+deltaq/InFlight.m",
        CLIENTS / "matlab/examples/turn_a1.m",
    )

    def why_not(self) -> str:
        return octave.why_no_octave()

    def turn_a1(self, port: int) -> list[str]:
        return octave.command(f"turn_a1('127.0.0.1', {port})")

    def answers(self, port: int, robot: str, compute_s: float, count: int) -> list[str]:
        given = f"'127.0.0.1', {port}, '{robot}', {compute_s}, {count}"
        return octave.command(f"addpath('{PROGRAMS}'); answers({given})")

    def far_turn(self, port: int, angle: float) -> list[str]:
        return octave.command(f"addpath('{PROGRAMS}'); far_turn('127.0.0.1', {port}, {angle})")

    def environment(self, **variables: str) -> dict[str, str]:
        return octave.environment(**variables)


class Cpp(Language):
    """Compiled once a run, with every warning an error."""

    name = "c++"
    sources = (CLIENTS / "cpp/deltaq.hpp", CLIENTS / "cpp/in_flight.hpp", CLIENTS / "cpp/turn_a1.cpp")

    def why_not(self) -> str:
        return "" if shutil.which("g++") else "g++ is not installed"

    def turn_a1(self, port: int) -> list[str]:
        return [self._compiled(CLIENTS / "cpp" / "turn_a1.cpp"), "127.0.0.1", str(port)]

    def answers(self, port: int, robot: str, compute_s: float, count: int) -> list[str]:
        given = ("127.0.0.1", str(port), robot, str(compute_s), str(count))
        return [self._compiled(PROGRAMS / "answers.cpp"), *given]

    def far_turn(self, port: int, angle: float) -> list[str]:
        return [self._compiled(PROGRAMS / "far_turn.cpp"), "127.0.0.1", str(port), str(angle)]

    @functools.cache  # noqa: B019 # there is one of this class
    def _compiled(self, source: Path) -> str:
        program = Path(_folder().name) / source.stem
        options = ("-std=c++17", "-Wall", "-Wextra", "-Werror", "-I", str(CLIENTS / "cpp"))
        subprocess.run(["g++", *options, "-o", str(program), str(source)], check=True)
        return str(program)


class Node(Language):
    """JavaScript as it is."""

    name = "node"
    sources = (
        CLIENTS / "javascript/deltaq.mjs",
        CLIENTS / "javascript/in_flight.mjs",
        CLIENTS / "javascript/turn_a1.mjs",
    )

    def why_not(self) -> str:
        return "" if shutil.which("node") else "node is not installed"

    def turn_a1(self, port: int) -> list[str]:
        return ["node", str(CLIENTS / "javascript" / "turn_a1.mjs"), "127.0.0.1", str(port)]

    def answers(self, port: int, robot: str, compute_s: float, count: int) -> list[str]:
        client = str(CLIENTS / "javascript" / "deltaq.mjs")
        given = ("127.0.0.1", str(port), robot, str(compute_s), str(count))
        return ["node", str(PROGRAMS / "answers.mjs"), client, *given]

    def far_turn(self, port: int, angle: float) -> list[str]:
        client = str(CLIENTS / "javascript" / "deltaq.mjs")
        return ["node", str(PROGRAMS / "far_turn.mjs"), client, "127.0.0.1", str(port), str(angle)]


LANGUAGES: tuple[Language, ...] = (Octave(), Cpp(), Node())


@functools.cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Gone when the tests end."""
    return tempfile.TemporaryDirectory(prefix="deltaq-clients-")
