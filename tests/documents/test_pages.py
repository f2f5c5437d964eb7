"""README, tutorial and every how-to, word for word: in an empty folder, with the wheel in an environment of its own."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pages
import pytest
from installed import ROOT, Installed
from networks import own_network

DOCS = ROOT / "docs"
PAGES = [
    ROOT / "README.md",
    *sorted((DOCS / "tutorial").glob("*.md")),
    *sorted((DOCS / "how-to").glob("*.md")),
]
SHORT = ("getting-started.md",)
"""What a reader does first; the other pages follow in `make nightly`."""

NOT_RUN = {
    "bring-your-own-robot.md": [
        "installs from a package index",
        "installs from a package index",
        "a line of a cell",
    ],
    "commission.md": [
        "tests/documents/test_commission.py runs it beside an emulated controller",
        "waits for keys",
        "tests/documents/test_commission.py runs it beside an emulated controller",
        "tests/documents/test_commission.py runs it beside an emulated controller",
    ],
    "talk-over-a-socket.md": [
        "tests/services/test_printed_conversation.py holds it with a running HLI",
        "tests/services/test_line_proofs.py says hello the same way",
        "tests/services/test_encrypted_lines.py makes one the same way",
        "needs the certificate; tests/services/test_encrypted_lines.py connects the same way",
        "needs two machines; tests/services/test_encrypting_recipe.py runs it on one",
    ],
    "getting-started.md": ["installs from a package index", "lines of the demonstration above"],
    "README.md": [
        "makes an environment of its own; the next block runs the same demonstration",
        "installs from a package index",
        "tests/clients/test_printed_programs.py runs it in Octave",
    ],
    "other-languages.md": [
        *["tests/clients/test_printed_programs.py runs it in Octave"] * 2,
        "tests/clients/test_octave_follower.py runs it in Octave beside a moving leader",
        *["tests/clients/test_printed_programs.py runs it"] * 2,
    ],
    "routines.md": [
        "two minutes of motion; tests/services/test_tool_changer.py changes tools in virtual time",
        "needs a stop at the right moment; tests/live/test_routines_live.py has one",
    ],
    "use-the-gate-alone.md": ["installs from a package index"],
    "ask-the-advisor.md": ["what the command above prints, in fewer columns"],
    "observe.md": ["needs Prometheus", "needs Prometheus", "a line of a log; tests/protocol/test_log.py"],
    "containers.md": [
        "needs a container engine; tests/deploy/launch/test_containers.py",
        *["needs a container engine; tests/deploy/launch/test_containers.py"] * 2,
        "needs a container engine; tests/deploy/launch/test_compose.py",
        "needs a container engine; tests/deploy/launch/test_containers.py",
    ],
    "several-machines.md": [
        "needs two machines; tests/live/test_encrypted_cell.py runs a cell off the loopback",
        "needs two machines; tests/security/test_identified_clients.py connects the same way",
        "needs two machines; tests/live/test_encrypted_hli.py connects the same way",
    ],
    "ros2.md": [
        "needs ROS",
        "needs ROS",
        "the last line of what has just ended; tests/controllers/test_ros2_bridge.py",
    ],
    "systemd.md": ["needs root, and systemd"],
    "two-sites.md": [
        "a picture",
        *["needs two machines; tests/live/test_two_sites.py does it"] * 4,
        "needs a clone and a minute; tests/experiments/test_far_controllers.py runs shorter ones",
        "needs a clone, root and a minute; tests/live/test_far_bounds.py runs it for each row",
    ],
    "lead-by-another-robot.md": [
        "waits for keys; tests/controllers/test_master.py leads a robot through the gate",
        "waits for keys; tests/controllers/test_master.py leads this arm by its twin",
    ],
    "drive-by-hand.md": [
        "waits for keys; tests/deploy/command/test_drive.py drives a terminal",
        "a file of the system",
        "steps of a script; tests/controllers/test_held_object.py runs similar ones",
        "steps of a script; tests/deploy/command/test_drive.py runs similar ones",
    ],
    "faults.md": [
        "takes some minutes; tests/testing/test_cell_under_test.py injects every fault",
        "needs a clone and a quarter of an hour; tests/testing/test_faults_live.py runs its parts",
    ],
    "measure.md": ["needs a clone; tests/testing/test_conservatism.py runs it"],
    "find-the-bug.md": ["installs from a package index"],
    "install.md": ["installs from a package index"],
    "train-a-policy.md": ["installs from a package index"],
    "run-a-cell.md": [
        "tests/deploy/launch/test_running_cell.py kills a service and starts it again this way",
        "needs real robots",
        "each line keeps its terminal; tests/services/test_robot_server_shell.py starts a service this way",
        "keeps its terminal; tests/services/test_roles.py reads tokens this way",
    ],
}
"""All that no test does as it is printed, and why: whoever adds to the pages' marks adds it here."""

_TESTING = ("hypothesis", "iniconfig", "packaging", "pluggy", "Pygments", "pytest", "sortedcontainers")
INSTALLED_BESIDE = {
    "help.md": _TESTING,
    "bring-your-own-robot.md": ("example-robot-data",),
    "lead-by-another-robot.md": ("example-robot-data",),
    "find-the-bug.md": _TESTING,
    "test-a-controller.md": _TESTING,
}
"""What a page has its reader install, from a package index that no test asks."""

OTHER_COMMENTS = {"table"}
"""Comments that other tests read."""

BUSY = "while True: pass"


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Other programs of ordinary priority that never rest."""
    programs = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()


def read(page: Path, installed: Installed, folder: Path, *options: str, timeout_s: float = 900.0) -> None:
    network = own_network()
    if network is None:
        pytest.skip("no network namespace is allowed here, and the pages name the ports of the lab cell")
    home, empty = folder / "home", folder / "empty"
    home.mkdir()
    empty.mkdir()
    for package in INSTALLED_BESIDE.get(page.name, ()):
        installed.add(package)
    command = [*network, sys.executable, pages.__file__, str(page), str(empty), *options]
    # in a group of its own, which a page that hangs is ended with
    with subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=installed.environment(HOME=str(home)),
        process_group=0,
    ) as reader:
        try:
            told, _ = reader.communicate(timeout=timeout_s)
        except BaseException:
            reader.send_signal(signal.SIGINT)  # it ends what it started
            raise
    assert reader.returncode == 0, told


@pytest.mark.service
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", [page for page in PAGES if page.name in SHORT], ids=lambda page: page.name)
def test_the_first_pages_run_word_for_word(page: Path, complete: Installed, tmp_path: Path) -> None:
    complete.take_machine_code()  # `make nightly` compiles as a reader does, beside two busy programs
    read(page, complete, tmp_path)


@pytest.mark.service
@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_page_runs_word_for_word_on_a_busy_machine(
    page: Path, complete: Installed, tmp_path: Path
) -> None:
    with busy(2):
        read(page, complete, tmp_path, "--nightly", timeout_s=3500)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_block_of_a_page_is_marked_with_its_use(page: Path) -> None:
    steps = list(pages.steps(page.read_text(encoding="utf-8")))
    silent = [step.line for step in steps if not step.kind and step.language in pages.TESTED_LANGUAGES]
    assert silent == [], "lines of blocks without a mark; tests/support/pages.py explains the marks"
    reasons = [step.argument for step in steps if step.kind == "not run"]
    assert reasons == NOT_RUN.get(page.name, [])
    assert all(reasons)


def test_every_test_that_runs_a_block_in_place_of_these_exists() -> None:
    named = re.findall(
        r"tests/[\w/.]+", " ".join(reason for reasons in NOT_RUN.values() for reason in reasons)
    )
    assert named
    assert [name for name in named if not (ROOT / name).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_mark_and_block_of_a_page_is_parsed(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    steps = list(pages.steps(text))
    comments = [comment for comment in re.findall(r"<!-- (.*?) -->", text) if comment not in OTHER_COMMENTS]
    assert len([step for step in steps if step.kind]) == len(comments)
    assert len([step for step in steps if step.text]) * 2 == len(re.findall(r"^ *```", text, re.MULTILINE))


def page_of(*blocks: str) -> str:
    return "\n\n".join(blocks)


SAYS = "<!-- run: sh -->\n```sh\necho one; echo two\n```"


@pytest.mark.parametrize(
    ("page", "told"),
    [
        (page_of("<!-- run: sh -->\n```sh\nfalse\n```"), "line 1: status 1"),
        (page_of("text", "<!-- run: python -->\n```python\nraise SystemExit(3)\n```"), "line 3: status 3"),
        (page_of(SAYS, "<!-- prints -->\n```text\ntwo\none\n```"), "'one' was not printed"),
        ("<!-- background: up -->\n```sh\necho down\n```", "'up' was never printed, but\ndown"),
        ("<!-- background: up -->\n```sh\ntrap '' INT; echo up; exit 4\n```", "status 4 after Ctrl-C"),
        ("<!-- runs: sh -->\n```sh\ntrue\n```", "'runs' is none of"),
    ],
    ids=["fails", "fails in python", "wrong order", "never up", "ends badly", "unknown mark"],
)
def test_a_wrong_page_fails(tmp_path: Path, page: str, told: str) -> None:
    with pytest.raises(pages.PageError, match=re.escape(told)):
        pages.Reader(tmp_path).read(page)
