"""Every example at the end of a help text, typed in an empty folder, and beside the lab cell where it needs one."""

from pathlib import Path

import pytest
from installed import Installed
from test_pages import read

from deltaq_deploy.command.app import EXAMPLES

NOT_RUN = {
    "deltaq demo --open": "opens a browser; `deltaq demo` below is the same",
    "deltaq drive --robot fr": "waits for keys; tests/deploy/command/test_drive.py drives a terminal",
    "deltaq ros2": "needs ROS; tests/controllers/test_ros2_bridge.py",
    "deltaq ros2 --accept-trajectories fr --domain-id 7": "the same",
    "deltaq krc sniff --port 49152": "needs a KRC; tests/deploy/command/test_rsi_command.py has an emulated one",
    "deltaq krc sniff --cell lab --robot fr --duration-s 2 --json": "the same",
    "deltaq krc echo --robot fr": "the same",
    "deltaq krc echo --cell lab --robot fr --duration-s 2 --json": "the same",
    "deltaq krc lag --robot fr": "takes minutes; tests/deploy/test_lag_sweep.py",
    "deltaq krc lag --cell lab --robot gr --output gr-lag.png --json": "the same",
}
BESIDE_THE_CELL = {
    "status", "topic echo", "topic hz", "recording record", "metrics", "audit", "drive", "run",
    "camera follow", "camera view", "camera show", "stop", "reset", "lease", "io", "contact", "dry-run",
    "fault inject",
}  # fmt: skip
UNTIL_CTRL_C = {
    "deltaq up": "cell lab is up",
    "deltaq up --cell lab-4ms --record start.mcap --no-console": "cell lab-4ms is up",
    "deltaq metrics": "ready: metrics",
    "deltaq metrics --cell lab --port 9465": "ready: metrics",
    "deltaq camera follow": "ready: fr follows gr",
}
"""What runs until Ctrl-C, and what it prints once it serves."""
MAY_FIND_FAULT = ("deltaq bench", "deltaq doctor")
"""Reports on this machine: status 1 is an answer too."""
BEFORE = {
    "recording replay": "deltaq experiment tracking --duration-s 2 --settle-s 0 --record run.mcap",
    "krc files": "rm -rf krc",
    "stop": "deltaq reset",
    "fault inject": "deltaq reset",
}
"""What has to be there, by verb."""
FILES = {
    "turn.py": (
        "class Turn:\n    cycles = 0\n\n    def increment(self, view):\n        self.cycles += 1\n"
        "        return None if self.cycles > 50 else [1e-4, 0, 0, 0, 0, 0]\n"
    ),
    "steps.yaml": "- {duration_s: 0.5, move: {z_m_s: 0.05}}\n",
    "stands.py": "def stands(state):\n    return [0.0] * len(state.q)\n",
    "half.py": "def half(q, dq):\n    return 0.5 * dq\n",
    "scenario.yaml": (
        "controller: stands.py:stands\nduration_s: 1.0\nfaults:\n  - {fault: krc_hiccup, at_s: 0.3}\n"
        "expect: {reasons: []}\n"
    ),
}


def blocks(beside: bool) -> list[str]:
    """The examples of verbs that need a running cell, or of all others, as blocks of a page."""
    made, seen = [], set(NOT_RUN)
    groups = {name.partition(" ")[0] for name in EXAMPLES if " " in name} - {"bench"}
    for name, examples in EXAMPLES.items():
        if name in groups or (name in BESIDE_THE_CELL) is not beside:
            continue
        made += [f"<!-- run: sh -->\n```sh\n{BEFORE[name]}\n```"] if name in BEFORE else []
        for example in (example for example in examples if example not in seen):
            seen.add(example)
            if example in UNTIL_CTRL_C:
                made += [
                    f"<!-- background: {UNTIL_CTRL_C[example]} -->\n```sh\n{example}\n```",
                    "<!-- Ctrl-C -->",
                ]
                continue
            if example == "deltaq status --watch":
                example = f"timeout --signal INT 5 {example} || [ $? = 124 ]"
            elif example.startswith(MAY_FIND_FAULT):
                example += " || [ $? = 1 ]"
            made.append(f"<!-- run: sh -->\n```sh\n{example}\n```")
    return made


def page() -> str:
    """All examples: alone first, then beside the lab cell."""
    files = [f"<!-- write: {name} -->\n```text\n{text}```" for name, text in FILES.items()]
    cell = "<!-- background: cell lab is up -->\n```sh\nrm -f *.mcap; exec deltaq up\n```"
    return "\n\n".join([*files, *blocks(beside=False), cell, *blocks(beside=True)])


@pytest.mark.service
@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_every_example_of_a_help_text_runs(complete: Installed, tmp_path: Path) -> None:
    file = tmp_path / "help.md"
    file.write_text(page(), encoding="utf-8")
    read(file, complete, tmp_path, timeout_s=3500)


def test_every_entry_of_the_table_is_an_example() -> None:
    assert all(len(examples) >= 2 for examples in EXAMPLES.values())
    assert NOT_RUN.keys() | UNTIL_CTRL_C.keys() <= {each for some in EXAMPLES.values() for each in some}
    assert BEFORE.keys() | BESIDE_THE_CELL <= EXAMPLES.keys()
