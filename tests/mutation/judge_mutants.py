"""Mutates the gate and the Robot Server's guards, and compares what survives with what is explained.

Run by `make mutation`. A mutant that no test kills, and that no `mutants.md` beside the code explains, is a
missing test; an explanation of a mutant that does not survive is out of date. Either fails.
"""

import json
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mutmut.utils.format_utils import orig_function_and_class_names_from_key

ROOT = Path(__file__).parents[2]
STAGE = ROOT / "build" / "mutation"
PACKAGES = {package.name: package.parent for package in ROOT.glob("[!.]*/deltaq_*")}
MUTMUT = Path(sys.executable).with_name("mutmut")
KILLED = ("killed", "timeout")


@dataclass(frozen=True, order=True)
class Mutant:
    """One change of one function.

    Attributes:
        file: path below the package's source root, such as `deltaq_services/sim/gate.py`.
        function: its name, that of a method with its class before it.
        change: lines taken out, then lines put in, each with its sign and without its indentation.
    """

    file: str
    function: str
    change: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join([f"{self.file}: {self.function}", *(f"    {line}" for line in self.change)])


def stage(modules: Sequence[str]) -> None:
    """Lay out packages side by side, since mutmut takes the name of a module from its path.

    Args:
        modules: of which mutants are made, which takes a while; of all in the settings if none is given.
    """
    shutil.rmtree(STAGE, ignore_errors=True)
    for package, source_root in PACKAGES.items():
        shutil.copytree(source_root / package, STAGE / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "tests", STAGE / "tests", ignore=shutil.ignore_patterns("__pycache__"))
    settings = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    if modules:
        files = json.dumps([f"{module.replace('.', '/')}.py" for module in modules])
        settings = re.sub(r"^only_mutate = \[.*?^\]", f"only_mutate = {files}", settings, flags=re.M | re.S)
    (STAGE / "pyproject.toml").write_text(settings, encoding="utf-8")


def mutmut(*arguments: str) -> str:
    """What one of mutmut's verbs prints."""
    return subprocess.run(
        [MUTMUT, *arguments], cwd=STAGE, check=True, stdout=subprocess.PIPE, text=True
    ).stdout


def verdicts() -> dict[str, str]:
    """Each mutant by mutmut's name for it, and what became of it."""
    return dict(re.findall(r"^ *(\S+): (.+)$", mutmut("results", "--all", "true"), re.MULTILINE))


def source_file(name: str) -> str:
    """Path of the file that a mutant was made of."""
    return name.rpartition(".")[0].replace(".", "/") + ".py"


def survivor(name: str) -> Mutant:
    """The mutant of that name."""
    function, owner = orig_function_and_class_names_from_key(name)
    diff = mutmut("show", name).splitlines()
    signed = [line for line in diff if re.match(r"[-+](?![-+]{2} )", line)]
    return Mutant(source_file(name), f"{owner}.{function}" if owner else function, _bare(signed))


def explained() -> Counter[Mutant]:
    """The mutants of every `mutants.md`; one that stands there twice is two alike."""
    found: Counter[Mutant] = Counter()
    for package, source_root in PACKAGES.items():
        for document in (source_root / package).rglob("mutants.md"):
            folder = document.parent.relative_to(source_root).as_posix()
            sections = re.split(r"^## ", document.read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]
            for section in sections:
                heading, _, body = section.partition("\n")
                named = re.fullmatch(r"`(\S+)` in `(\S+)`", heading)
                if named is None:
                    raise ValueError(f"{document}: a heading names `function` in `file`, got {heading!r}")
                for block in re.findall(r"^```diff\n(.*?)^```", body, re.MULTILINE | re.DOTALL):
                    for change in re.findall(r"(?:^-.*\n)*(?:^\+.*\n)+|(?:^-.*\n)+", block, re.MULTILINE):
                        found[Mutant(f"{folder}/{named[2]}", named[1], _bare(change.splitlines()))] += 1
    return found


def _bare(signed: list[str]) -> tuple[str, ...]:
    return tuple(line[0] + line[1:].strip() for line in signed)


def main(jobs: int, modules: Sequence[str]) -> int:
    """Make mutants of some modules, or of all, judge them and compare; returns the exit status."""
    stage(modules)
    patterns = [f"{module}.x*" for module in modules]
    subprocess.run([MUTMUT, "run", "--max-children", str(jobs), *patterns], cwd=STAGE, check=True)
    judged = {name: verdict for name, verdict in verdicts().items() if verdict != "not checked"}
    files = sorted({source_file(name) for name in judged})
    survivors = Counter(survivor(name) for name, verdict in judged.items() if verdict not in KILLED)
    excused = Counter({mutant: count for mutant, count in explained().items() if mutant.file in files})
    print(f"\n{'file':42}{'mutants':>10}{'killed':>10}{'timed out':>10}{'alive':>10}")
    for file in [*files, ""]:
        counts = Counter(
            verdict if verdict in KILLED else "alive"
            for name, verdict in judged.items()
            if source_file(name).startswith(file)
        )
        columns = (counts.total(), counts["killed"], counts["timeout"], counts["alive"])
        print(f"{file or 'all':42}" + "".join(f"{count:10}" for count in columns))
    for mutant in sorted(survivors - excused):
        print(f"\nsurvives and is not explained: {mutant}")
    for mutant in sorted(excused - survivors):
        print(f"\nis explained and does not survive: {mutant}")
    return int(survivors != excused)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), sys.argv[2:]))
