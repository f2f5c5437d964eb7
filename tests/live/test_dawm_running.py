"""The dual-arm cell as `deltaq up` runs it: its Robot Server keeps the time, and any client moves all 17 joints."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import numpy as np
import pytest
from commands import PROGRAM
from json_client import json_client

from deltaq_cell.cell_model import CellModel
from deltaq_testing.private_cell import free_ports

pytestmark = [pytest.mark.live, pytest.mark.nightly]


async def test_a_client_of_json_lines_moves_all_joints_of_the_dual_arm_cell(tmp_path: Path) -> None:
    hli, sim, tcp, server = free_ports(4)
    file = tmp_path / "private.yaml"
    file.write_text(
        f"extends: dawm\nhli: tcp/127.0.0.1:{hli}\nsim: tcp/127.0.0.1:{sim}\ntcp_port: {tcp}\n"
        f"robots: {{dawm: {{server: tcp/127.0.0.1:{server}}}}}\n",
        encoding="utf-8",
    )
    launcher = subprocess.Popen(
        [PROGRAM, "up", "--no-console", "--cell", str(file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    assert launcher.stdout is not None
    try:
        said = []
        for line in launcher.stdout:
            said.append(line)
            if "is up" in line:
                break
        else:
            pytest.fail("".join(said))
        robot = CellModel.load(file).robots["dawm"]
        async with json_client(tcp) as client:
            while (await client.receive("state"))["phase"] == "offline":
                pass
            granted = await client.ask("lease", type="lease", robot="dawm", action="acquire")
            assert granted["granted"], granted
            start = None
            for seq in range(1, 41):
                state = await client.receive("state")
                start = start or state
                ramp = min(seq, 40 - seq) / 20 * 0.1 * robot.max_velocity * 0.012
                client.send(type="increment", robot="dawm", seq=seq, cycle=state["cycle"], dq=ramp.tolist())
                verdict = await client.receive("verdict", "error")
                assert verdict.get("outcome") in ("admitted", "scaled"), verdict
            while (state := await client.receive("state"))["phase"] != "ready":
                pass
        moved = np.array(state["q"]) - np.array(start["q"])
        assert np.all(moved > 0.2 * 0.1 * robot.max_velocity * 40 * 0.012)
        assert state["q"] == state["q_cmd"]  # it is where it was sent
        T_world_left = robot.forward(np.array(state["q"]), "left")
        np.testing.assert_allclose(state["tool"]["position"], T_world_left[:3, 3], atol=1e-9)
    finally:
        launcher.send_signal(signal.SIGINT)
        rest, _ = launcher.communicate(timeout=300)
    assert launcher.returncode == 0, rest
