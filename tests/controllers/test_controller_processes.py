"""Leader and follower as processes, on a cell of real services over zenoh and UDP."""

import asyncio
import json
import signal
import subprocess
import sys

import numpy as np
import pytest
from shared_cell import SharedStack

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.camera.scene import Scene
from deltaq_experiments.scene import VIEW_DISTANCE_M
from deltaq_protocol.blocking import connect
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import Sight, ViewTarget
from deltaq_protocol.reasons import ReasonCode
from deltaq_testing.private_cell import free_ports

pytestmark = [pytest.mark.live, pytest.mark.nightly]

FOLLOWER, LEADER = "deltaq_controllers.camera_follower", "deltaq_controllers.leader"


def start(module: str, *arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", module, *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen[str]) -> tuple[int, dict[str, object], str]:
    """Exit status, the JSON object of the last line, and what was said on stderr."""
    try:
        out, err = process.communicate(timeout=300)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        raise
    return process.returncode, json.loads(out.splitlines()[-1]), err


@pytest.fixture(scope="module")
def url(shared_stack: SharedStack) -> str:
    return shared_stack.renewed().cell.hli


def test_without_a_server_leader_and_follower_exit_with_status_3() -> None:
    nowhere = f"tcp/127.0.0.1:{free_ports(1)[0]}"
    for module in (FOLLOWER, LEADER):
        status, summary, err = finish(start(module, "--url", nowhere))
        assert status == 3
        assert summary["cycles"] == 0
        assert err.startswith("error: ")
        assert "Traceback" not in err


@pytest.mark.parametrize(
    ("module", "arguments", "message"),
    [
        (FOLLOWER, ("--robot", "gr", "--leader", "fr"), "'gr' has no camera"),
        (FOLLOWER, ("--robot", "xx"), "no robot 'xx'; it has fr, gr"),
        (LEADER, ("--speed-m-s", "-1"), "speed_m_s"),
        (LEADER, ("--robot", "xx"), "no robot 'xx'; it has fr, gr"),
    ],
)
def test_an_impossible_use_of_the_cell_ends_with_2(
    url: str, module: str, arguments: tuple[str, ...], message: str
) -> None:
    status, summary, err = finish(start(module, "--url", url, *arguments))
    assert status == 2
    assert message in err
    assert "Traceback" not in err
    assert summary["cycles"] == 0


def test_a_running_follower_takes_another_distance_and_another_target(url: str) -> None:
    follower = start(FOLLOWER, "--url", url, "--controller", "predictive")
    lab = CellModel.load("lab")
    try:
        with connect(url, client="operator") as cell:
            q_leader = lab.robots["gr"].home
            target = Scene(lab, "fr", "gr", (0.0, 0.0, 0.04)).focus_at(q_leader)
            told = cell.view("fr", distance_m=1.0, aim_offset_m=(0.0, 0.0, 0.04))
            assert told.view.distance_m == 1.0
            with pytest.raises(RefusedError, match="gr carries no camera"):
                cell.view("gr", distance_m=1.0)
            with pytest.raises(InvalidMessageError, match="distance_m"):
                cell.view("fr", distance_m=9.0)
            for state in cell.states("fr"):
                assert follower.poll() is None
                lens = lab.robots["fr"].camera_pose(state.q)[:3, 3]
                if abs(float(np.linalg.norm(target - lens)) - 1.0) < 0.005:
                    assert state.view == told.view
                    break
            assert cell.view("fr").holder == "camera-follower"
            # it outlives the follower, and others share the cell
            cell.view("fr", distance_m=VIEW_DISTANCE_M, aim_offset_m=(0.0, 0.0, 0.0))
        follower.send_signal(signal.SIGTERM)
        status, summary, err = finish(follower)
    finally:
        follower.kill()
        follower.communicate()
    assert status == 0, err
    assert summary["robot"] == "fr", "the cell's first with a camera"


def test_a_running_follower_changes_from_a_hidden_target_to_the_next_and_logs_it(url: str) -> None:
    under_the_deck = ViewTarget(focus_m=(-0.55, -2.2, 0.3))
    with connect(url, client="operator") as cell:
        cell.view("fr", targets=[under_the_deck, ViewTarget(leader="gr")])
        follower = start(FOLLOWER, "--url", url, "--controller", "qp")
        try:
            told: list[tuple[ViewTarget, Sight | None]] = []
            for state in cell.states("fr"):
                assert follower.poll() is None
                assert state.reason is not ReasonCode.KRC_LOST  # such a robot turns to nothing any more
                if state.target is not None and (state.target, state.sight) not in told:
                    told.append((state.target, state.sight))
                if state.target == ViewTarget(leader="gr"):
                    break
            cell.view("fr", leader="gr")
            follower.send_signal(signal.SIGTERM)
            out, err = follower.communicate(timeout=300)
        finally:
            follower.kill()
            follower.communicate()
    hidden = [(under_the_deck, Sight.FRESH), (under_the_deck, Sight.HIDDEN)]
    assert told == [*hidden, (ViewTarget(leader="gr"), Sight.FRESH)]
    assert follower.returncode == 0, err
    assert "view_hidden by structure/deck" in out
    assert "looks at gr" in out
    assert json.loads(out.splitlines()[-1])["view"]["view_hidden"] > 0


def test_the_camera_follows_the_leader_over_real_processes_until_sigterm_ends_both(url: str) -> None:
    leader = start(LEADER, "--url", url, "--seed", "1")
    follower = start(FOLLOWER, "--url", url, "--duration-s", "6", "--settle-s", "3")
    try:
        status, followed, err = finish(follower)
        assert status == 0, err
        leader.send_signal(signal.SIGTERM)
        status, led, err = finish(leader)
        assert status == 0, err
    finally:
        for process in (leader, follower):
            process.kill()
            process.communicate()
    assert followed["controller"] == "qp"
    assert led["controller"] == "leader"
    assert led["robot"] == "gr", "the one that the cell's camera watches"
    for summary in (followed, led):
        counts = summary["gate"]
        assert isinstance(counts, dict)
        assert summary["cycles"] > 20
        assert counts["admitted"] > 10, summary
    # how well is a figure of the machine, which others may use as well; `test_tracking_table.py` holds the law's own
    assert followed["angle_deg"]["max"] < 45.0
    view = followed["view"]
    assert view["fresh"] > 20
    # clocks of one machine: what is left of their offset is the way to the HLI, and no more than is said
    assert set(view["clocks"]) == {"fr", "gr"}
    for clock in view["clocks"].values():
        assert abs(clock["offset_s"]) <= clock["error_s"] + 0.1
    assert view["age_s"]["max"] >= view["age_s"]["rms"] >= 0.0
    assert set(view) == {*Sight, "changes", "age_s", "clocks"}
    assert followed["distance_m"]["max"] < 1.0


def test_a_second_follower_is_refused_the_lease_and_exits_with_1(url: str) -> None:
    first = start(FOLLOWER, "--url", url)
    try:
        assert first.stdout is not None
        assert first.stdout.readline().startswith("ready: fr follows gr")

        async def until_leased() -> None:
            from deltaq_protocol import connect

            async with connect(url) as cell:
                async for _ in cell.verdicts("fr"):
                    return

        asyncio.run(asyncio.wait_for(until_leased(), 300))
        status, _, err = finish(start(FOLLOWER, "--url", url, "--duration-s", "5"))
        assert status == 1
        assert "lease_taken" in err
        first.send_signal(signal.SIGINT)
        assert finish(first)[0] == 0
    finally:
        first.kill()
