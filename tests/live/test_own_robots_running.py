"""Robots that are not deltaq's in a running cell: the guide word for word, and three arms on three Robot Servers."""

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from commands import PROGRAM, deltaq
from json_client import json_client
from own_robot import write_cell, write_package

from deltaq_cell.find import find_file
from deltaq_cell.load import load_cell
from deltaq_protocol import connect
from deltaq_protocol.client import Cell
from deltaq_testing.private_cell import free_ports

pytestmark = pytest.mark.live

GUIDE = Path(__file__).parents[2] / "docs" / "how-to" / "bring-your-own-robot.md"
COMMANDS_S = 240


@contextmanager
def up(cell: Path) -> Iterator[None]:
    """The cell runs for the length of the block, and ends as Ctrl-C ends it."""
    command = [PROGRAM, "up", "--no-console", "--cell", str(cell)]
    launcher = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert launcher.stdout is not None
    try:
        said = []
        for line in launcher.stdout:
            said.append(line)
            if "is up" in line:
                break
        else:
            pytest.fail("".join(said))
        yield
    finally:
        launcher.send_signal(signal.SIGINT)
        rest, _ = launcher.communicate(timeout=300)
    assert launcher.returncode == 0, rest


def blocks(what: str, language: str) -> list[str]:
    """The blocks of the guide that are run so, or the one that is this file."""
    marked = rf"<!-- {what} -->\n```{language}\n(.*?)^```"
    return re.findall(marked, GUIDE.read_text(), re.MULTILINE | re.DOTALL)


def shell(text: str, folder: Path) -> str:
    """Run a block as it is; what it printed."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euc", text], cwd=folder, env=os.environ | {"PATH": path}, capture_output=True, text=True,
        timeout=COMMANDS_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def on_other_ports(cell: str) -> str:
    """The guide's cell, on ports that nobody uses."""
    hli, sim, tcp, *servers = free_ports(5)
    for shown, server in zip(("7451", "7452"), servers, strict=True):
        assert f"127.0.0.1:{shown}" in cell
        cell = cell.replace(f"127.0.0.1:{shown}", f"127.0.0.1:{server}")
    return f"{cell}hli: tcp/127.0.0.1:{hli}\nsim: tcp/127.0.0.1:{sim}\ntcp_port: {tcp}\n"


@pytest.mark.nightly
def test_the_guide_leads_from_two_published_urdfs_to_a_replayed_motion(tmp_path: Path) -> None:
    find_file(
        "package://example-robot-data/robots/panda_description/urdf/panda.urdf"
    )  # the extra `dev` has it
    (tmp_path / "arms.yaml").write_text(on_other_ports(*blocks("write: arms.yaml", "yaml")))
    for script in ("wave.yaml", "turn.yaml"):
        (tmp_path / script).write_text(*blocks(f"write: {script}", "yaml"))
    check, move, ask, replay = blocks("run: sh", "sh")
    checked = shell(check, tmp_path)
    assert checked.startswith("arms.yaml: good")
    assert "panda_link6 - panda_link7" in checked
    with up(tmp_path / "arms.yaml"):
        told = shell(move, tmp_path)
        asked = shell(ask, tmp_path)
    assert "ur was driven" in told
    assert "panda" in told
    assert "panda is at option 1" in asked
    assert asked.count("ur: options") == 2
    replayed = json.loads(shell(replay.strip() + " --json", tmp_path))
    assert replayed["good"]
    assert replayed["verdicts"] > 0
    assert replayed["fingerprint"] == replayed["recorded_fingerprint"]


async def turn(running: Cell, robot: str) -> None:
    """Turn the first joint of a robot by a twentieth of a radian, through the gate."""
    async with running.lease(robot) as leased:
        start = None
        async for state in leased.states():
            start = start or state
            if abs(state.q[0] - start.q[0]) > 0.05:
                return
            await leased.move([0.004, 0.0, 0.0])


@pytest.mark.nightly
async def test_three_robot_servers_move_under_one_gate_and_no_client_needs_their_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ws"))
    package = write_package(tmp_path / "ws")
    file = write_cell(tmp_path, robots=3)
    cell = load_cell(file)
    with up(file):
        shutil.rmtree(package)  # what runs has read it, and nobody else shall need it
        command = [sys.executable, "-m", "deltaq_services.recorder", "--cell", str(file)]
        recorder = subprocess.Popen(
            [*command, "--file", str(tmp_path / "run.mcap")], stdout=subprocess.PIPE, text=True
        )
        assert recorder.stdout is not None
        try:
            assert recorder.stdout.readline().startswith("ready:")
            async with json_client(cell.tcp_port) as client:
                described = await client.ask("description", type="describe")
                assert set(described["hulls"]) == set(cell.robots) == {"arm_0", "arm_1", "arm_2"}
            async with connect(cell.hli, "test") as running:
                await asyncio.gather(*(turn(running, robot) for robot in cell.robots))
        finally:
            recorder.send_signal(signal.SIGTERM)
            recorder.communicate(timeout=300)
        status = json.loads(deltaq("status", "--cell", str(file), "--json").stdout)
        assert set(status["robots"]) == set(cell.robots)
        assert status["nearest"] is not None
        script = tmp_path / "task.yaml"
        script.write_text("- {duration_s: 0.5, mode: joint, move: {lift_deg_s: 10, Reach_mm_s: 20}}\n")
        drive = ("drive", "--robot", "arm_2", "--cell", str(file), "--script", str(script), "--json")
        driven = json.loads(deltaq(*drive).stdout)
        assert driven["gate"]["admitted"] > 0
    replayed = json.loads(deltaq("recording", "replay", str(tmp_path / "run.mcap"), "--json").stdout)
    assert replayed["good"]
    assert replayed["verdicts"] > 10
