"""The stack in containers on a real engine; `make container-test` builds the image first."""

import subprocess
import time
from collections.abc import Iterator

import pytest
from ran import ran
from test_compose import FILE

from deltaq_cell.load import load_cell
from deltaq_protocol.blocking import connect
from deltaq_protocol.messages import Phase

pytestmark = pytest.mark.container


def compose(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = ["docker", "compose", "--project-name", "deltaq-test", "--file", str(FILE), *arguments]
    return ran(command, check=False)


@pytest.fixture(scope="module")
def seconds_to_healthy() -> Iterator[float]:
    begin = time.monotonic()
    try:
        up = compose("up", "--wait")
        assert up.returncode == 0, up.stderr + compose("logs").stdout
        yield time.monotonic() - begin
    finally:
        compose("down", "--timeout", "10")


def test_the_engine_reads_the_file_as_written() -> None:
    config = compose("config", "--quiet")
    assert config.returncode == 0, config.stderr


def test_an_increment_from_outside_the_containers_moves_fr(seconds_to_healthy: float) -> None:
    begin = time.monotonic()
    step = 0.001  # [rad] in a cycle of 12 ms
    with connect(load_cell("lab").hli, client="outside") as cell:
        if cell.status().robots["fr"].phase is Phase.HELD:
            # while the other containers started, the emulator's telegrams may have been late
            cell.reset("fr")
        with cell.lease("fr") as robot:
            states = robot.states()
            start = next(states).q[0]
            while next(states).q[0] < start + 10 * step:
                robot.move([step, 0, 0, 0, 0, 0])
                assert time.monotonic() - begin < 30, robot.state
    print(f"healthy after {seconds_to_healthy:.0f} s, moved {time.monotonic() - begin:.1f} s later")


def test_the_controllers_of_the_demonstration_start_only_on_demand(seconds_to_healthy: float) -> None:
    services = compose("ps", "--services").stdout.split()
    assert seconds_to_healthy > 0
    assert set(services) == {
        "robot-server-fr",
        "robot-server-gr",
        "emulator-fr",
        "emulator-gr",
        "sim",
        "hli",
        "console",
    }
