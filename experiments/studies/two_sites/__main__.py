"""What the camera follower reaches on two sites: `python -m studies.two_sites`, as root.

Robot Servers and gate run beside the (emulated) robots, the HLI in the office, leader and follower behind a link that
delays and loses packets; with `--virtual` the same in virtual time. The figures are those of
`deltaq experiment tracking`, on the robots' own time stamps: what the controllers see late is not late in them.
"""

import argparse
import json
import signal
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deltaq_cell.cell_model import CellModel
from deltaq_deploy.launch.program import run_program
from deltaq_emulator.faults import LinkFaults
from deltaq_experiments.live import trace_of
from deltaq_experiments.scene import scene_of
from deltaq_protocol import topics
from deltaq_protocol.messages import RobotState
from deltaq_services.process import end_on_interrupt
from deltaq_services.recorder.reader import Recording
from studies.two_sites.far_virtual import figures_of, follow_in_virtual_time
from studies.two_sites.packets import packet_link
from studies.two_sites.sites import Sites, sites
from studies.two_sites.sites_run import DELTAQ, SiteError, TwoSites, two_sites

_TO_START_S = 60.0
"""Longest time that the motion to the start of a run may take."""


def measure(given: argparse.Namespace) -> dict[str, Any]:
    """Run both sites and follow; the figures.

    Raises:
        DeltaqError: if networks of their own are not allowed here, or something did not come up.
        KeyboardInterrupt: at Ctrl-C; programs and networks are gone by then.
    """
    faults = LinkFaults(
        delay_s=given.delay_s - given.jitter_s,
        jitter_s=2 * given.jitter_s,
        drop=given.loss_share,
        keeps_order=True,
    )
    with (
        tempfile.TemporaryDirectory() as folder,
        sites() as made,
        packet_link(made.controller, made.office, given.seed) as link,
    ):
        made.connect_wide_area()
        link.impair(faults)
        figures = _follow(given, made, Path(folder))
        carried = [dict(way.counts) for way in link.ways]
    return {"packets": {name: sum(way[name] for way in carried) for name in ("passed", "dropped")}, **figures}


def _follow(given: argparse.Namespace, made: Sites, folder: Path) -> dict[str, Any]:
    record = folder / "run.mcap"
    with two_sites(made, folder, given.transport) as running:
        recorder = running.run(
            "recorder",
            made.office,
            (*DELTAQ, "recording", "record", "--output", str(record), "--cell", str(running.file)),
        )
        running.get_ready()
        print(
            f"both sites are up; the follower follows for {given.duration_s:g} s", file=sys.stderr, flush=True
        )
        leader = running.controller(
            "leader",
            "deltaq_controllers.leader",
            "--speed-m-s",
            f"{given.leader_speed_m_s}",
            "--seed",
            f"{given.seed}",
        )
        leader.wait_for("ready: ")
        follower = running.controller(
            "follower", "deltaq_controllers.camera_follower", "--controller", given.controller,
            "--duration-s", f"{given.duration_s}", "--settle-s", f"{given.settle_s}",
        )  # fmt: skip
        if status := follower.wait(_TO_START_S + given.duration_s):
            raise SiteError(f"the follower ended with status {status}:\n{follower.text()}")
        if leader.has_ended:
            raise SiteError(f"the leader ended before the follower:\n{leader.text()}")
        cell_status = running.ask("status")
        leader.end()
        recorder.end()
        return _figures(given, running, record, follower.last_json(), cell_status)


def _figures(
    given: argparse.Namespace,
    running: TwoSites,
    record: Path,
    summary: dict[str, Any],
    status: dict[str, Any],
) -> dict[str, Any]:
    states = [
        one.message
        for one in Recording.open(record).messages([topics.STATE])
        if isinstance(one.message, RobotState)
    ]
    scene = scene_of(CellModel.load(running.file))
    trace = trace_of(states, (scene.robot_name, scene.leader_name), {}, summary["began_s"], given.duration_s)
    robots = {name: robot["counters"] for name, robot in status["robots"].items()}
    return {
        **figures_of(trace, scene, given),
        "follower": {name: summary[name] for name in ("cycles", "unanswered", "gate", "reasons")},
        "admissions": {name: counters.get("admissions", 0) for name, counters in robots.items()},
    }


def options_of(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """The options of a command line; a wrong one ends the program with what is wrong."""
    parser = argparse.ArgumentParser(prog="python -m studies.two_sites", description=__doc__)
    parser.add_argument(
        "--delay-s", type=float, default=0.04, help="of a packet, each way (default: %(default)s)"
    )
    parser.add_argument("--jitter-s", type=float, default=0.01, help="more or less (default: %(default)s)")
    parser.add_argument(
        "--loss-share", type=float, default=0.01, help="of packets, each way (default: %(default)s)"
    )
    parser.add_argument(
        "--transport",
        choices=("tcp", "tcp+udp"),
        default="tcp+udp",
        help="of the way from the controllers to the HLI (default: %(default)s)",
    )
    parser.add_argument("--controller", default="predictive", help="that follows (default: %(default)s)")
    parser.add_argument(
        "--leader-speed-m-s",
        type=float,
        default=0.1,
        help="that its tool is asked for (default: %(default)s)",
    )
    parser.add_argument("--duration-s", type=float, default=30.0, help="to follow for (default: %(default)s)")
    parser.add_argument("--settle-s", type=float, default=5.0, help="that is left out (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of link and leader (default: %(default)s)")
    parser.add_argument(
        "--virtual", action="store_true", help="in virtual time, with a model of TCP; needs no root"
    )
    given = parser.parse_args(argv)
    if given.duration_s <= given.settle_s or given.settle_s < 0.0:
        parser.error(f"--duration-s {given.duration_s:g}: more than --settle-s, which is not negative")
    if not 0.0 <= given.loss_share < 1.0:
        parser.error(f"--loss-share {given.loss_share:g}: from 0 to less than 1")
    if given.leader_speed_m_s <= 0.0 or given.jitter_s < 0.0:
        parser.error("--leader-speed-m-s is more than 0, --jitter-s not negative")
    if given.delay_s < given.jitter_s:
        parser.error("--jitter-s: more than --delay-s, and no packet arrives before it was sent")
    return given


def main(argv: Sequence[str] | None = None) -> None:
    """Measure, and print one JSON object."""
    given = options_of(argv)
    asked = (
        "delay_s",
        "jitter_s",
        "loss_share",
        "transport",
        "controller",
        "leader_speed_m_s",
        "seed",
    )
    signal.signal(signal.SIGTERM, end_on_interrupt)
    figures = follow_in_virtual_time(given) if given.virtual else measure(given)
    print(json.dumps({"virtual": given.virtual} | {name: getattr(given, name) for name in asked} | figures))


if __name__ == "__main__":
    run_program(main, "studies.two_sites")
