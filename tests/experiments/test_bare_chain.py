"""The bare chain of the benchmark, with real processes: every topic is passed on, and what goes wrong is an error."""

import os
import signal
import time
from pathlib import Path

import pytest

from deltaq_experiments.bench.bare_chain import PASSES, measured
from deltaq_protocol.errors import DeltaqError


def test_every_forwarded_topic_has_a_receiver() -> None:
    taken = {topic for passes in PASSES.values() for topic in passes}
    passed_on = {topic for passes in PASSES.values() for topics in passes.values() for topic in topics}
    assert passed_on | {"guarded/state"} == taken


@pytest.mark.service
def test_states_return_as_admissions_and_every_process_takes_time(tmp_path: Path) -> None:
    chain = measured(["left-arm"], 0.012, 1.0, tmp_path, time.sleep)
    assert set(chain.processor_us) == {"robot-server-left-arm", "sim", "hli", "client-left-arm"}
    assert all(us > 0.0 for us in chain.processor_us.values())
    assert all(count > 0.0 for count in chain.wakeups.values())
    assert 0.0 < chain.age_p50_ms <= chain.age_p99_ms
    assert 0.0 < chain.in_time <= 1.0


@pytest.mark.service
def test_a_killed_process_of_the_chain_is_an_error_and_leaves_no_process(tmp_path: Path) -> None:
    def kill_one(for_s: float) -> None:
        newest = children()[-1]
        if for_s == 2.0:
            os.kill(newest, signal.SIGKILL)
            os.waitid(os.P_PID, newest, os.WEXITED | os.WNOWAIT)

    before = set(children())
    with pytest.raises(DeltaqError, match="ended before its time"):
        measured(["fr"], 0.012, 2.0, tmp_path, kill_one)
    assert set(children()) <= before


def test_a_folder_whose_path_is_too_long_for_a_socket_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DeltaqError, match="did not serve"):
        measured(["fr"], 0.012, 1.0, tmp_path / ("x" * 120), time.sleep)


def children() -> list[int]:
    """Processes that this one started, the newest last."""
    return [
        int(pid) for file in Path("/proc/self/task").glob("*/children") for pid in file.read_text().split()
    ]
