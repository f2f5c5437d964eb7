"""What a follower reaches from far away over real processes: each bound that the page states, for some seeds.

Figures depend on the machine: the bounds are wide. In virtual time `tests/experiments/test_far_controllers.py` holds
narrow ones.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from far_bounds import BOUNDS, FarBound, module_and_options
from networks import why_none

from deltaq_cell.cell_model import CellModel
from deltaq_emulator.faults import LinkFaults
from deltaq_experiments.live import trace_of
from deltaq_protocol import topics
from deltaq_protocol.messages import RobotState
from deltaq_services.recorder.reader import Recording
from studies.two_sites.packets import packet_link
from studies.two_sites.sites import sites
from studies.two_sites.sites_run import DELTAQ, Running, TwoSites, two_sites

pytestmark = [
    pytest.mark.live,
    pytest.mark.nightly,
    pytest.mark.timeout(600),
    pytest.mark.skipif(bool(why_none()), reason=why_none()),
]
SEEDS = (0, 1)

ACROSS = LinkFaults(delay_s=0.02, jitter_s=0.02, drop=0.01, keeps_order=True)
"""30 ms more or less 10 ms each way, and one packet of a hundred is lost."""
NOTHING = LinkFaults(drop=1.0)
CUT_CYCLES = 167
"""Of 12 ms: two seconds."""


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: bound.link)
def test_a_remote_follower_keeps_the_bound_of_its_link(bound: FarBound, seed: int) -> None:
    module, options = module_and_options(bound, seed)
    command = [sys.executable, "-m", module, *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    print(done.stdout)  # pytest shows it with -rA
    told = json.loads(done.stdout)
    assert bound.real.is_kept(told), done.stdout
    assert told["robots_clearance_m"] >= 0.05, done.stdout


def follow(running: TwoSites, *arguments: str) -> tuple[Running, Running]:
    """Start leader and follower far away, once both robots are free."""
    leader = running.controller("leader", "deltaq_controllers.leader")
    leader.wait_for("ready: ")
    module = "deltaq_controllers.camera_follower"
    follower = running.controller("follower", module, "--controller", "qp", *arguments)
    follower.wait_for("ready: ")
    return leader, follower


def test_two_seconds_without_a_link_cost_only_the_leases(tmp_path: Path) -> None:
    record = tmp_path / "run.mcap"
    with sites() as made, packet_link(made.controller, made.office, seed=5) as link:
        made.connect_wide_area()
        with two_sites(made, tmp_path) as running:
            link.impair(ACROSS)
            recorder = running.run(
                "recorder",
                made.office,
                (*DELTAQ, "recording", "record", "--output", str(record), "--cell", str(running.file)),
            )
            running.get_ready()
            leader, follower = follow(running)
            running.panel("gr", op="await", cycles=3 * CUT_CYCLES)
            link.impair(NOTHING)
            running.panel("gr", op="await", cycles=CUT_CYCLES)
            link.impair(ACROSS)
            for name in running.cell.robots:
                running.panel(name, op="await", at_rest=True, cycles=10, within_s=12)
            robots = running.ask("status")["robots"]
            assert {robot["phase"] for robot in robots.values()} == {"held"}
            assert {robot["reason"] for robot in robots.values()} == {"controller_lost"}
            assert [leader.wait(30.0), follower.wait(30.0)] != [0, 0]
            for name in running.cell.robots:
                running.ask("reset", "--robot", name)
            leader, follower = follow(running, "--duration-s", "10", "--settle-s", "5")
            assert follower.wait(60.0) == 0, follower.text()
            again = follower.last_json()
            leader.end()
            recorder.end()
            cell = CellModel.load(running.file)
    assert again["angle_deg"]["rms"] < 1.0, again
    states = [
        one.message
        for one in Recording.open(record).messages([topics.STATE])
        if isinstance(one.message, RobotState)
    ]
    assert trace_of(states, tuple(cell.robots), {}).robot_clearances(cell).min() >= 0.05
