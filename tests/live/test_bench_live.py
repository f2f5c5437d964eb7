"""`deltaq bench --live` on a cell of real processes: what it tells is complete and agrees with itself."""

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest
from commands import PROGRAM

from deltaq_experiments.bench.live import LiveOptions, run_once
from deltaq_experiments.bench.live_figures import NAMES
from deltaq_testing.private_cell import write_private_cell

pytestmark = pytest.mark.live

NEEDS_CORES = pytest.mark.skipif(
    len(os.sched_getaffinity(0)) < 4,
    reason="a cell of two robots at 4 ms takes more than two cores give, and starves what has no real-time priority",
)
PROCESSES = {
    "robot-server-fr",
    "robot-server-gr",
    "emulator-fr",
    "emulator-gr",
    "sim",
    "hli",
    "leader",
    "follower",
}
BARE = {"robot-server-fr", "robot-server-gr", "sim", "hli", "client-fr", "client-gr"}


def judge(run: dict[str, Any], *, slow: bool = True) -> None:
    """Whatever the machine is like, these hold; only of slow cycles is the longest one of a controller promised."""
    assert run["silent"] == []
    assert run["overwritten"] == 0
    assert set(run["processor_us"]) == PROCESSES
    assert all(us > 0.0 for us in run["processor_us"].values())
    assert set(run["wakeups"]) == PROCESSES
    assert all(count > 0.0 for count in run["wakeups"].values())
    assert run["reference"]["cycles"] > 0
    assert 0.0 <= run["reference"]["in_time"] <= 1.0
    assert set(run["robots"]) == {"fr", "gr"}
    for robot in run["robots"].values():
        assert 0 < robot["fresh"] <= robot["cycles"]
        assert robot["admission_rate"] == robot["fresh"] / robot["cycles"]
        assert sum(robot["braked"].values()) == robot["cycles"] - robot["fresh"]
        stations = robot["stations"]
        assert [station["station"] for station in stations] == list(NAMES.values())
        for station in stations:
            age = station["age_ms"]
            assert 0 < age["count"] == robot["increments"] - station["missing"]
            assert 0.0 < age["p50"] <= age["p99"] <= age["p99_9"] <= age["longest"]
    whats = [row["what"] for row in run["rows"]]
    assert whats == [
        "fr: admission rate",
        "fr: longest cycle of its controller",
        "gr: admission rate",
        "gr: longest cycle of its controller",
        "processor time of a cycle, all processes",
        "processor time that the host gave to others",
        "processor time of a cycle, beside bare Python",
        "wake-ups of a cycle, beside bare Python",
        "fr: telegram to admission, beside bare Python",
        "fr: its p99, beside bare Python",
        "gr: telegram to admission, beside bare Python",
        "gr: its p99, beside bare Python",
    ]
    promised = [what for what in whats if "admission rate" in what or (slow and "longest cycle" in what)]
    assert [row["what"] for row in run["rows"] if row["kept"] is not None] == promised
    rows = {row["what"]: row for row in run["rows"]}
    assert 0.0 <= rows["processor time that the host gave to others"]["value"] <= 100.0
    assert set(run["bare"]["processor_us"]) == set(run["bare"]["wakeups"]) == BARE
    assert rows["processor time of a cycle, beside bare Python"]["ratio"] > 1.0


@pytest.mark.nightly
def test_every_station_of_a_running_cell_is_stamped(tmp_path: Path) -> None:
    cell = str(write_private_cell(tmp_path))
    judge(run_once(LiveOptions(cell, "paper", warm_up_s=0.5, duration_s=2.0)).model_dump(mode="json"))


@pytest.mark.nightly
@pytest.mark.parametrize("base", ["lab", pytest.param("lab-4ms", marks=NEEDS_CORES)])
def test_the_command_reports_every_run(tmp_path: Path, base: str) -> None:
    cell = str(write_private_cell(tmp_path, base))
    command = [
        PROGRAM,
        "bench",
        "--live",
        "--cell",
        cell,
        "--runs",
        "2",
        "--duration-s",
        "5",
        "--warm-up-s",
        "2",
    ]
    done = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode in (0, 1), done.stderr  # 1: a bound is missed, on a machine with other work
    assert done.stdout, done.stderr
    table = json.loads(done.stdout)
    assert [len(table["runs"]), table["follower"]] == [2, "qp"]
    for run in table["runs"]:
        judge(run, slow=base == "lab")
    assert table["good"] == all(run["good"] for run in table["runs"]) == (done.returncode == 0)
