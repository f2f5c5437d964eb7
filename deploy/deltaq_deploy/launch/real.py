"""Whether a cell's addresses can be those of real robots, checked before anything listens."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from deltaq_cell.description import CellDescription, RsiDescription
from deltaq_cell.find import resolve_near
from deltaq_cell.krc_files import judge_krc_files
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.rsi import load_ethernet_xml
from deltaq_protocol.rsi.judge import is_any, is_loopback


class NotRealError(DeltaqError):
    """A cell that is not ready for real robots; the message has a line for each reason."""


def refuse_unreal(cell: CellDescription, file: Path, robots: Iterable[str]) -> None:
    """Refuse addresses at which no real KRC can be, and files of a KRC that cannot be safe.

    A loopback both in the cell and in the KRC's file is accepted: an emulator that was started by hand.

    Args:
        cell: the cell.
        file: its file.
        robots: those whose Robot Server is to run here.

    Raises:
        NotRealError: with every reason.
        EthernetConfigError: a `*_ethernet.xml` cannot be read.
    """
    if reasons := [reason for name in robots for reason in _reasons(cell, file, name)]:
        raise NotRealError("\n".join(["this cell is not ready for real robots:", *reasons]))


def _reasons(cell: CellDescription, file: Path, name: str) -> Iterator[str]:
    robot = cell.robots[name]
    driver = robot.driver
    if not isinstance(driver, RsiDescription):
        return
    where = f"robots.{name}.driver"
    config = load_ethernet_xml(resolve_near(file, driver.ethernet_xml))
    if is_loopback(driver.address):
        if is_loopback(config.ip_number):
            return
        yield (
            f"{where}.address: {driver.address} is this machine's own, and no KRC reaches it; {config.source} lets the "
            f"KRC send to {config.ip_number}: write that, if it is this machine's address on the robot's network"
        )
    if driver.krc_address is None:
        yield (
            f"{where}.krc_address: is missing: any host's datagram would be taken for the KRC's; write the KRC's "
            "address on the robot's network"
        )
    elif is_loopback(driver.krc_address) or is_any(driver.krc_address):
        yield (
            f"{where}.krc_address: {driver.krc_address} is no address of a KRC; write the one on the robot's network"
        )
    elif driver.krc_address == driver.address:
        yield f"{where}.krc_address: {driver.krc_address} is this machine's own, as driver.address says"
    for finding in judge_krc_files(file, robot, cell.cycle_s):
        if finding.severity == "error":
            yield f"{'.'.join((where, *finding.field))}: {finding}"
