"""A cell on two sites and a controller far away: it moves, it rests when cut off, it goes on."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from networks import why_none

from deltaq_deploy.launch import INTERRUPTED
from deltaq_emulator.faults import LinkFaults
from studies.two_sites.packets import packet_link
from studies.two_sites.sites import sites
from studies.two_sites.sites_run import Running, SiteError, TwoSites, two_sites

pytestmark = [
    pytest.mark.live,
    pytest.mark.timeout(600),
    pytest.mark.skipif(bool(why_none()), reason=why_none()),
]
NETWORKS = Path("/run/netns")
FAR_AWAY = LinkFaults(delay_s=0.03, jitter_s=0.02, drop=0.01)
"""40 ms more or less 10 ms each way, and one packet of a hundred is lost."""


@pytest.fixture
def running(tmp_path: Path) -> Iterator[TwoSites]:
    with sites() as made, packet_link(made.controller, made.office, seed=5) as link:
        made.connect_wide_area()
        with two_sites(made, tmp_path) as running:
            link.impair(FAR_AWAY)
            yield running
        assert sum(way.counts["dropped"] for way in link.ways) > 0


def wait_until(reached: Callable[[dict[str, Any]], object], running: TwoSites, tries: int = 60) -> None:
    """Until the office's status is as wanted; each look takes as long as a command does."""
    for _ in range(tries):
        status = running.ask("status")
        if reached(status):
            return
    pytest.fail(f"it never was: {status}")


def moved(running: TwoSites, robot: str, before: list[float]) -> float:
    after = running.panel(robot)["q_setpoint"]
    return max(abs(one - other) for one, other in zip(after, before, strict=True))


def wait_until_led(running: TwoSites, leader: Running) -> None:
    """Until gr has been moved."""
    before = running.panel("gr")["q_setpoint"]
    for _ in range(100):
        running.panel("gr", op="await", cycles=20)
        if moved(running, "gr", before) > 0.01:
            return
    pytest.fail(f"the leader did not move its robot: {leader.text()}")


@pytest.mark.nightly
def test_robots_stop_when_their_site_is_cut_off_and_resume_as_documented(running: TwoSites) -> None:
    office, robots = running.identities
    assert [one.name for one in office.iterdir()] == ["hli"], "who breaks in there cannot speak as the gate"
    assert sorted(one.name for one in robots.iterdir()) == ["robot-server-fr", "robot-server-gr", "sim"]
    status = running.ask("status")
    assert status["mismatches"] == []
    assert {robot["phase"] for robot in status["robots"].values()} <= {"ready", "held"}
    running.get_ready()
    leader = running.controller("leader", "deltaq_controllers.leader", "--speed-m-s", "0.1")
    leader.wait_for("ready: ")
    wait_until_led(running, leader)

    running.sites.cut()
    for name in running.cell.robots:
        running.panel(name, op="await", at_rest=True, cycles=100, within_s=12)
    for name in running.cell.robots:
        before = running.panel(name)["q_setpoint"]
        running.panel(name, op="await", cycles=50)
        assert moved(running, name, before) == 0.0
    # the office knows that it hears nobody
    wait_until(lambda status: {r["phase"] for r in status["robots"].values()} == {"offline"}, running)
    with pytest.raises(SiteError):
        running.ask("reset", "--robot", "gr")

    running.sites.mend()
    wait_until(lambda status: {r["phase"] for r in status["robots"].values()} == {"held"}, running)
    reasons = {robot["reason"] for robot in running.ask("status")["robots"].values()}
    assert reasons == {"hli_lost"}
    for name in running.cell.robots:
        running.ask("reset", "--robot", name)
    wait_until(lambda status: status["robots"]["fr"]["phase"] == "ready", running)
    wait_until_led(running, leader)  # which has kept its lease, since the HLI is on its side of the cut


@pytest.mark.nightly
def test_an_interrupted_measurement_leaves_neither_networks_nor_processes() -> None:
    command = [sys.executable, "-m", "studies.two_sites", "--duration-s", "600"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as measuring:
        assert measuring.stderr is not None
        assert measuring.stderr.readline().startswith("both sites are up")
        networks = list(NETWORKS.glob(f"deltaq-{measuring.pid}-*"))
        assert len(networks) == 3
        listed = [subprocess.check_output(["ip", "netns", "pids", one.name], text=True) for one in networks]
        programs = " ".join(listed).split()
        assert len(programs) > 5
        measuring.terminate()
        assert measuring.stderr.read() == ""
        assert measuring.wait() == INTERRUPTED
    assert not [one for one in networks if one.exists()]
    assert not [program for program in programs if Path("/proc", program).exists()]
