"""`python -m deltaq_emulator --cell lab --robot fr`: run the emulated controller of one robot."""

import argparse
import gc
import logging
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from deltaq_cell.description import RsiDescription
from deltaq_cell.load import find_cell, load_cell, resolve_near
from deltaq_cell.robot import RobotModel
from deltaq_emulator.context import NOTHING, Context, read_context
from deltaq_emulator.krc import Krc
from deltaq_emulator.settings import SHIPPED, KrcSettings, SettingsError, profile_for
from deltaq_emulator.shell import Emulator
from deltaq_protocol import log
from deltaq_protocol.arrays import Array
from deltaq_protocol.endpoint import Address
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.real_time import SchedulingPriority, ask_for_real_time
from deltaq_protocol.rsi import AxisMap, load_ethernet_xml

_log = logging.getLogger(__name__)


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT with a port of 1 to 65535")
    return host, int(port)


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="deltaq_emulator", description="Emulated KRC of one robot of a cell."
    )
    parser.add_argument("--cell", required=True, help="name of a cell, or path of its YAML file")
    parser.add_argument("--robot", required=True, help="name of the robot in the cell")
    parser.add_argument("--record", type=Path, metavar="FILE.csv", help="write every cycle to this file")
    parser.add_argument(
        "--settings", type=Path, default=SHIPPED, metavar="FILE.yaml", help="of the controller"
    )
    parser.add_argument(
        "--context",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="RSI context (.rsi.xml, .rsix) or KRL program (.src) whose limits count instead of the settings'; "
        "may be given more than once",
    )
    parser.add_argument("--server", type=_address, metavar="HOST:PORT", help="instead of the cell's driver")
    parser.add_argument(
        "--panel", type=_address, metavar="HOST:PORT", help="instead of the cell's control_port"
    )
    parser.add_argument("--address", metavar="HOST", help="the controller's own, for a second one beside it")
    parser.add_argument("--seed", type=int, default=0, help="of injected network faults")
    return parser.parse_args(argv)


def build(
    cell_name: str, robot_name: str, settings: KrcSettings, context: Context = NOTHING
) -> tuple[Krc, RsiDescription]:
    """The controller of one robot of a cell, at its home, and the driver with its addresses.

    Args:
        cell_name: name of a cell, or path of its file.
        robot_name: name of the robot in it.
        settings: of the controller.
        context: settings from the files of its RSI application, which take precedence.

    Raises:
        DeltaqError: if the cell, its robot or a file that it names cannot be used.
    """
    cell = load_cell(cell_name)
    if (robot := cell.robots.get(robot_name)) is None:
        raise SettingsError(
            f"cell {cell.cell!r} has no robot {robot_name!r}; it has {', '.join(cell.robots)}"
        )
    if not isinstance(robot.driver, RsiDescription):
        raise SettingsError(
            f"robot {robot_name!r} has no KRC to emulate: its driver is {robot.driver.kind!r}"
        )
    try:
        ethernet_xml = resolve_near(find_cell(cell_name), robot.driver.ethernet_xml)
    except FileNotFoundError as error:
        raise SettingsError(f"robots.{robot_name}.driver.ethernet_xml: {error}") from error
    model = RobotModel(robot, robot_name)
    T_base_world = np.linalg.inv(model.T_world_base)

    def forward(q: Array) -> Array:
        return np.asarray(T_base_world @ model.forward(q))

    settings = context.settings(settings)
    axes = AxisMap.of(robot.joint_names, robot.units, robot.driver.krc)
    krc = Krc(
        robot,
        cell.cycle_s,
        load_ethernet_xml(ethernet_xml),
        profile_for(robot.driver.krc, cell.cycle_s),
        robot.home,
        forward,
        settings,
        limits=context.limits(axes, settings),
    )
    return krc, robot.driver


def main(argv: Sequence[str] | None = None) -> int:
    """Run until a signal; exit status 0, or 2 if the configuration cannot be used."""
    arguments = _arguments(argv)
    stop_signals: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda received, _frame: stop_signals.append(received))
    try:
        log.configure("emulator", arguments.robot)
        settings, context = KrcSettings.load(arguments.settings), read_context(arguments.context)
        krc, driver = build(arguments.cell, arguments.robot, settings, context)
        server = arguments.server or (driver.address, driver.port)
        panel = arguments.panel
        if panel is None and driver.control_port is not None:
            panel = (driver.address, driver.control_port)
        emulator = Emulator(arguments.robot, krc, server, panel, arguments.seed, arguments.address)
        try:
            if arguments.record is not None:
                emulator.recorder.start(arguments.record)
            # no object that exists now is garbage: spare every collection the visit
            gc.collect()
            gc.freeze()
            ask_for_real_time(SchedulingPriority.EMULATOR)
            emulator.run(lambda: bool(stop_signals), lambda: _announce(arguments.robot, krc, server))
        finally:
            emulator.close()
    except DeltaqError as error:
        _log.error("%s", error)
        return 2
    return 0


def _announce(robot: str, krc: Krc, server: Address) -> None:
    _log.info("ready: %s sends to %s:%s every %g ms", robot, *server, krc.cycle_s * 1e3)


if __name__ == "__main__":
    sys.exit(main())
