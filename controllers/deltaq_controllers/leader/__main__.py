"""The scripted leader as a process: `python -m deltaq_controllers.leader --url tcp/127.0.0.1:7447`."""

import argparse
import asyncio
import contextlib
import logging

from deltaq_cell.load import parse_cell
from deltaq_cell.roles import camera_roles
from deltaq_controllers.interface import Controller
from deltaq_controllers.leader.attacking import TARGETS, AttackingLeader
from deltaq_controllers.leader.scripted import STICK_ACCELERATION_M_S2, ScriptedLeader
from deltaq_controllers.live import ControlStatistics, drive, model_of, robot_models, run
from deltaq_protocol import connect
from deltaq_protocol.client import DEFAULT_ADDRESS

_log = logging.getLogger(__name__)


async def lead(options: argparse.Namespace, statistics: ControlStatistics) -> None:
    """Connect and lead for as long as asked."""
    async with connect(options.url, client="scripted-leader") as cell:
        models, cycle_s = robot_models(cell.description), cell.description.cycle_s
        if options.robot is None:
            options.robot = camera_roles(parse_cell(cell.description.yaml, cell.description.cell)).leader
        model = model_of(models, options.robot)
        controller: Controller
        if options.attack is None:
            controller = ScriptedLeader(
                model, cycle_s, options.speed_m_s, options.seed, stick_m_s2=options.stick_m_s2
            )
            does = "leads"
        else:
            victim = model_of(models, options.attack)
            controller = AttackingLeader(
                model,
                victim,
                cycle_s,
                options.speed_m_s,
                options.seed,
                options.target,
                options.stick_m_s2,
            )
            does = f"attacks {options.attack}"
        _log.info("ready: %s %s at %g m/s", options.robot, does, options.speed_m_s)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(options.duration_s):
                await drive(cell, options.robot, controller, statistics)


def main() -> int:
    """Run the process; returns its exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_controllers.leader",
        description="Move a robot's tool like an operator; one JSON line of counts at the end.",
    )
    parser.add_argument("--url", default=DEFAULT_ADDRESS, help="where the HLI serves (default: %(default)s)")
    parser.add_argument(
        "--robot", help="robot to lead with (default: the one that the cell's camera watches)"
    )
    parser.add_argument("--speed-m-s", type=float, default=0.25, help="tool speed (default: %(default)s)")
    parser.add_argument(
        "--stick-m-s2",
        type=float,
        default=STICK_ACCELERATION_M_S2,
        help="largest acceleration of the tool that the operator asks for (default: %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=0, help="seed of the motion (default: %(default)s)")
    parser.add_argument("--attack", metavar="ROBOT", help="a robot to collide with, repeatedly")
    parser.add_argument(
        "--target", default="lens", help=f"point to collide with: {', '.join(TARGETS)} (default: %(default)s)"
    )
    parser.add_argument("--duration-s", type=float, default=None, help="end after this time (default: never)")
    options, statistics = parser.parse_args(), ControlStatistics()
    return run(
        lead(options, statistics),
        lambda: {"controller": "leader", "robot": options.robot, **statistics.summary()},
        "leader",
        options.robot or "",
    )


if __name__ == "__main__":
    raise SystemExit(main())
