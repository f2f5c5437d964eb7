"""`deltaq advise`: from a robot's home, and on a running cell through the gate."""

import json
import re
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import PROGRAM, deltaq
from typer.testing import CliRunner

from deltaq_cell.cell_model import CellModel
from deltaq_cell.description import CellDescription
from deltaq_controllers.task import load_task
from deltaq_deploy.command.advice import AdviceRequest, advice
from deltaq_deploy.command.app import app
from deltaq_testing.private_cell import free_ports

pytestmark = pytest.mark.long

DAWM = CellModel.load("dawm").robots["dawm"]


def advised(*arguments: str) -> tuple[int, dict[str, object]]:
    done = CliRunner().invoke(app, ["advise", "--offline", "--json", "--effort", "0.3", *arguments])
    return done.exit_code, json.loads(done.stdout) if done.stdout else {}


def test_json_options_are_one_object_with_complete_values() -> None:
    status, found = advised("--options", "3", "--seed", "4")
    assert status == 0
    assert (found["cell"], found["robot"], found["method"], found["seed"]) == ("dawm", "dawm", "annealing", 4)
    assert found["executed"] is None
    options = found["options"]
    assert isinstance(options, list)
    assert [option["rank"] for option in options] == list(range(1, len(options) + 1))
    assert 1 <= len(options) <= 3
    assert found["weights"] == {"travel": 1.0, "obstacle_clearance": 1.0, "self_clearance": 1.0}
    hands = found["hands"]
    assert isinstance(hands, dict)
    for option in options:
        for hand, pose in hands.items():
            np.testing.assert_allclose(DAWM.forward(option["q"], hand), pose, atol=1e-9)
        assert option["room_m"] > 0
        assert set(option["values"]) == set(option["costs"])
        assert option["nearest_limit"] in DAWM.joint_names
        assert set(option["near"]) <= {"self", "environment", "robots"}
        assert option["path"] is not None
        assert (option["hands_move"], option["hands_leave"]) == (False, False)
    assert options[0]["energy"] <= options[0]["energy_here"]


def test_a_task_gives_a_robot_that_is_not_redundant_options_within_its_tolerance() -> None:
    status, found = advised("--cell", "lab", "--task", "gauge")
    assert status == 0
    assert (found["robot"], found["task"]) == ("fr", "Read a gauge with the camera")
    assert found["joints"] == ["a1", "a2", "a3", "a4", "a5", "a6"]
    options = found["options"]
    assert isinstance(options, list)
    assert len(options) >= 3
    assert all((len(one["q"]), one["hands_leave"]) == (6, False) for one in options)


def test_a_task_that_knows_few_bodies_asks_the_cell_that_has_all_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def connected(description: CellDescription, _client: str) -> None:
        raise RuntimeError(", ".join(description.structure))

    monkeypatch.setattr("deltaq_deploy.command.advice.connect", connected)
    with pytest.raises(RuntimeError, match="pipe_high"):
        advice(AdviceRequest("dawm", task=load_task("saw_cut")))


def test_one_hand_gets_a_new_pose_and_the_other_stays() -> None:
    status, found = advised("--hand", "left=1.7,0.3,1.5,0,90,0", "--options", "1")
    assert status == 0
    (option,) = found["options"]  # type: ignore[misc] # a list, as the test before sees
    np.testing.assert_allclose(DAWM.forward(option["q"], "left")[:3, 3], [1.7, 0.3, 1.5], atol=1e-9)
    np.testing.assert_allclose(
        DAWM.forward(option["q"], "right"), DAWM.forward(DAWM.home, "right"), atol=1e-9
    )
    assert option["hands_move"] is True
    np.testing.assert_array_equal(option["path"][0], DAWM.home)
    np.testing.assert_allclose(option["path"][-1], option["q"], atol=1e-9)


def test_weights_choose_the_ranking_of_options() -> None:
    _, found = advised("--criterion", "manipulability=1", "--weight", "travel=0.5", "--options", "1")
    (option,) = found["options"]  # type: ignore[misc] # a list
    assert found["weights"] == {"manipulability": 1.0, "travel": 0.5}
    assert option["energy"] == pytest.approx(
        option["costs"]["manipulability"] + 0.5 * option["costs"]["travel"]
    )


def test_a_trade_off_lists_options_from_one_criterion_to_the_other() -> None:
    status, found = advised("--trade-off", "travel,self_clearance")
    assert status == 0
    assert found["trade_off"] == ["travel", "self_clearance"]
    options = found["options"]
    assert isinstance(options, list)
    costs = [[option["costs"][name] for name in ("travel", "self_clearance")] for option in options]
    assert len(costs) >= 2
    assert costs == sorted(costs)


def test_a_non_redundant_arm_gets_marked_options_if_its_hand_may_leave() -> None:
    status, found = advised("--cell", "lab", "--robot", "fr", "--hands-may-leave")
    assert status == 0
    options = found["options"]
    assert isinstance(options, list)
    assert any(option["hands_leave"] for option in options)
    done = CliRunner().invoke(
        app,
        ["advise", "--offline", "--cell", "lab", "--robot", "fr", "--hands-may-leave"],
        terminal_width=200,
    )
    words = done.stdout.replace("│", " ").split()  # a narrow column puts them below one another
    assert {"leave", "come", "back"} <= set(words)


def test_hands_out_of_reach_are_reported_with_exit_status_1() -> None:
    status, found = advised("--hand", "left=9,0,1,0,0,0", "--method", "brute-force")
    assert status == 1
    assert found["options"] == []
    done = CliRunner().invoke(
        app,
        ["advise", "--offline", "--hand", "left=9,0,1,0,0,0", "--method", "brute-force", "--effort", "0.1"],
    )
    assert "no configuration holds the hands there" in done.stdout


@pytest.mark.by_day(1)
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--hand", "left=1,2"), "NAME=X,Y,Z,ROLL,PITCH,YAW"),
        (("--hand", "middle=1,0,1,0,0,0"), "no hand 'middle'; it has left, right"),
        (("--weight", "travel"), "NAME=NUMBER"),
        (("--weight", "travle=1"), "no criterion 'travle'"),
        (("--method", "guess"), "no method 'guess'"),
        (("--robot", "fr"), "no robot 'fr' in cell dawm"),
        (("--robot", "fr", "--cell", "lab"), "'fr' is not redundant"),
        (("--robot", "fr", "--cell", "lab"), "may leave and come back: give --hands-may-leave"),
        (("--execute", "1"), "needs a running cell"),
        (("--trade-off", "travel"), "takes the names of two criteria, A,B, got 'travel'"),
        (("--trade-off", "travel,travel"), "takes the names of two criteria"),
        (("--trade-off", "travel,travle"), "no criterion 'travle'"),
    ],
)
def test_a_malformed_request_is_answered_with_the_expected_form(
    arguments: tuple[str, ...], said: str
) -> None:
    done = deltaq("advise", "--offline", "--effort", "0.1", *arguments)
    assert done.returncode == 2
    assert said in " ".join(done.stderr.replace("│", " ").split())


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    hli, sim, tcp, server = free_ports(4)
    file = tmp_path_factory.mktemp("cell") / "private.yaml"
    file.write_text(
        f"extends: dawm\nhli: tcp/127.0.0.1:{hli}\nsim: tcp/127.0.0.1:{sim}\ntcp_port: {tcp}\n"
        f"robots: {{dawm: {{server: tcp/127.0.0.1:{server}}}}}\n",
        encoding="utf-8",
    )
    command = [PROGRAM, "up", "--no-console", "--cell", str(file)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as launcher:
        assert launcher.stdout is not None
        for line in launcher.stdout:
            if "is up" in line:
                break
        else:
            pytest.fail("the cell did not come up")
        yield file
        launcher.send_signal(signal.SIGINT)
        launcher.communicate(timeout=300)
        assert launcher.returncode == 0


def executed(cell: Path, *arguments: str) -> dict[str, Any]:
    """Go to the best option that has a path; what was found, with the robot at rest there and given back."""

    def advise(option: int) -> subprocess.CompletedProcess[str]:
        return deltaq("advise", "--cell", str(cell), "--execute", str(option), "--json", *arguments)

    option, done = 1, advise(1)
    if instead := re.search(
        r"options with a path: (\d+)", done.stderr
    ):  # which a busy machine may not find in time
        option = int(instead[1])
        done = advise(option)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    driven = found["executed"]
    assert (driven["option"], driven["reached"]) == (option, True)
    # a machine that is busy with other things loses cycles, and after each the robot speeds up again
    assert driven["outcomes"]["admitted"] > 0
    assert driven["outcomes"]["refused"] == 0
    assert driven["hands_off_m"] < 1e-4
    status = deltaq("status", "--cell", str(cell), "--json")
    robot = json.loads(status.stdout)["robots"]["dawm"]
    assert robot["lease"]["holder"] is None
    np.testing.assert_allclose(robot["q"], found["options"][option - 1]["q"], atol=1e-4)
    return found


@pytest.mark.nightly
@pytest.mark.live
def test_an_option_is_driven_to_through_the_gate_with_the_hands_still(cell: Path) -> None:
    found = executed(cell, "--options", "3")
    assert not any(option["hands_move"] for option in found["options"])


@pytest.mark.live
@pytest.mark.nightly
def test_hands_are_driven_to_their_requested_poses(cell: Path) -> None:
    found = executed(cell, "--options", "1", "--hand", "left=1.6,0.4,1.4,0,90,0")
    assert all(option["hands_move"] for option in found["options"])
