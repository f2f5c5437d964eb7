"""Controllers far away: what they reach in virtual time, and that a link that is too bad for them costs no limit."""

import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest
from far_bounds import BOUNDS, FarBound, module_and_options

from deltaq_testing.virtual_cell.cell import VirtualCell
from studies.two_sites import __main__ as two_sites
from studies.two_sites.far_controller import FarWire
from studies.two_sites.far_virtual import follow_in_virtual_time

FAST = ["--virtual", "--duration-s", "4", "--settle-s", "2"]
CUT_CYCLES = 167
"""Of 12 ms: two seconds."""
NO_VIOLATION = {"position_violations": 0, "velocity_violations": 0, "acceleration_violations": 0}


def figures(capsys: pytest.CaptureFixture[str], *options: str) -> dict[str, Any]:
    two_sites.main([*FAST, *options])
    told: dict[str, Any] = json.loads(capsys.readouterr().out)
    return told


@pytest.mark.nightly
def test_a_link_with_long_losses_brakes_the_robots_within_limits(
    capsys: pytest.CaptureFixture[str],
) -> None:
    told = figures(capsys, "--delay-s", "0.06", "--loss-share", "0.2")
    assert told["messages_lost"] > 0
    assert told["limits"] == NO_VIOLATION
    assert told["robots_clearance_m"] >= 0.05
    assert min(told["admission_rate"].values()) < 0.9


@pytest.mark.nightly
@pytest.mark.parametrize("seed", ["3", "4"])
def test_a_remote_controller_follows_despite_late_and_lost_packets(
    capsys: pytest.CaptureFixture[str], seed: str
) -> None:
    transport = {"3": "tcp+udp", "4": "tcp"}[seed]
    link = ("--delay-s", "0.04", "--jitter-s", "0.01", "--loss-share", "0.01", "--seed", seed)
    link += ("--transport", transport)
    told = figures(capsys, *link)
    assert told["messages_lost"] > 0
    assert told["limits"] == NO_VIOLATION
    assert told["angle_deg"]["rms"] < 1.0
    assert told["distance_cm"]["rms"] < 2.0
    assert min(told["admission_rate"].values()) > 0.9
    if seed == "3":
        assert figures(capsys, *link) == told


def test_the_page_states_bounds_of_five_links() -> None:
    assert [bound.link.split()[:2] for bound in BOUNDS] == [
        ["--delay-s", delay_s] for delay_s in ("0.03", "0.03", "0.06", "0.075", "0.25")
    ]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("bound", BOUNDS, ids=lambda bound: bound.link)
def test_a_remote_follower_keeps_the_bound_of_its_link_in_virtual_time(
    bound: FarBound, seed: int, capsys: pytest.CaptureFixture[str]
) -> None:
    two_sites.main(["--virtual", *module_and_options(bound, seed)[1]])
    told = json.loads(capsys.readouterr().out)
    assert bound.virtual.is_kept(told), told
    assert told["limits"] == NO_VIOLATION
    assert told["robots_clearance_m"] >= 0.05


@pytest.mark.nightly
def test_controllers_cut_off_for_two_seconds_lose_their_robots_at_rest_and_clear() -> None:
    """With datagrams, that is: an increment under way when the link is cut is lost, and none comes late."""
    given = two_sites.options_of(
        ["--virtual", "--controller", "qp", "--delay-s", "0.03", "--jitter-s", "0.01", "--loss-share", "0.01",
         "--leader-speed-m-s", "0.25", "--duration-s", "5", "--settle-s", "1"]
    )  # fmt: skip
    setpoints: list[list[float]] = []

    def cut(stack: VirtualCell, wires: Sequence[FarWire]) -> None:
        if len(setpoints) == CUT_CYCLES:
            for wire in wires:
                wire.cut_until_s = stack.now_s + 2.0
        setpoints.append([float(q) for arm in stack.krc_arms.values() for q in arm.krc.sample.q_setpoint])

    told = follow_in_virtual_time(given, cut)
    assert told["messages_lost"] > 100
    assert set(told["phases"].values()) == {"held"}
    assert set(told["reasons"].values()) == {"controller_lost"}
    assert told["limits"] == NO_VIOLATION
    assert told["robots_clearance_m"] >= 0.05
    moved = [before != after for before, after in pairwise(setpoints)]
    assert all(moved[CUT_CYCLES // 2 : CUT_CYCLES])
    assert not any(moved[2 * CUT_CYCLES :])
