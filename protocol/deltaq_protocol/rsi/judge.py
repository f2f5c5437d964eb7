"""Checks the files that a KRC has loaded against the cell's description of its robot.

An error could move a robot without a command, or prevent a stop; a warning could make an outage worse.
Pure: texts and descriptions in, findings out.
"""

import ipaddress
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from deltaq_protocol.errors import Severity
from deltaq_protocol.rsi.axes import AxisMap, EthernetConfigError
from deltaq_protocol.rsi.ethernet_xml import ElementType, EthernetConfig
from deltaq_protocol.rsi.layout import correction_fields


@dataclass(frozen=True)
class Finding:
    """One fault in a KRC's file.

    Attributes:
        severity: an error keeps the Robot Server from starting; a warning does not.
        element: path of the element in the file, e.g. `RECEIVE/AK.A1`.
        message: the fault, its consequence and the remedy.
        value: the value in the file, if it has one.
        bound: the allowed value.
        field: the field of the cell's `driver` that it concerns.
        source: name of the file.
    """

    severity: Severity
    element: str
    message: str
    value: str | int | None = None
    bound: str | int | None = None
    field: tuple[str, ...] = ("ethernet_xml",)
    source: str = ""

    def __str__(self) -> str:
        """`fr_ethernet.xml: RECEIVE/AK.A1: HOLDON is 0, …`."""
        return f"{self.source}: {self.element}: {self.message}"


@dataclass(frozen=True)
class Station:
    """The PC's end of one robot's RSI, as the cell describes it.

    Attributes:
        axes: the robot's joints.
        address: the Robot Server listens here.
        port: and on this UDP port.
        inputs: per digital input its TAG.
        outputs: per digital output its TAG.
        stop: TAG of the BOOL that ends the motion; None if the cell names none.
        cycle_s: the cell's cycle [s]; None if nothing is to be compared with it.
    """

    axes: AxisMap
    address: str
    port: int
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    stop: str | None = None
    cycle_s: float | None = None

    @property
    def emulated(self) -> bool:
        """No real KRC can reach this address."""
        return is_loopback(self.address)


def is_loopback(address: str) -> bool:
    """Whether an address reaches nothing but this machine."""
    ip = _ip(address)
    return address == "localhost" if ip is None else ip.is_loopback


def is_any(address: str) -> bool:
    """Whether an address stands for all interfaces, such as 0.0.0.0."""
    ip = _ip(address)
    return address == "" if ip is None else ip.is_unspecified


def judge(config: EthernetConfig, station: Station) -> tuple[Finding, ...]:
    """Check a `*_ethernet.xml` against the cell.

    Whether corrections are absolute, and how many decimals the KRC sends, is in its program and context: see
    `judge_program` and `judge_context`.

    Args:
        config: the file that the KRC has loaded.
        station: the cell's description.

    Returns:
        Findings, errors and warnings, in no particular order; empty if there are none.
    """
    checks = (_direction, _address, _corrections, _measurements, _signals, _stop)
    return tuple(replace(found, source=config.source) for check in checks for found in check(config, station))


def _direction(config: EthernetConfig, _: Station) -> Iterator[Finding]:
    if config.only_send:
        yield Finding(
            "error",
            "CONFIG/ONLYSEND",
            "is TRUE: the KRC takes no replies, so nothing that passes the gate reaches it; write FALSE",
            "TRUE",
            "FALSE",
        )


def _address(config: EthernetConfig, station: Station) -> Iterator[Finding]:
    # an emulator on this machine sends to the cell's address, whatever the file says
    if station.emulated:
        return
    if config.port != station.port:
        yield Finding(
            "error",
            "CONFIG/PORT",
            f"is {config.port}, but the Robot Server listens on {station.port}: no server, or another "
            "robot's, would answer the KRC; write the same in both",
            config.port,
            station.port,
            ("port",),
        )
    if not _reaches(config.ip_number, station.address):
        yield Finding(
            "error",
            "CONFIG/IP_NUMBER",
            f"is {config.ip_number}, but the Robot Server listens on {station.address}: the KRC would send its "
            "telegrams elsewhere; write the PC's address on the robot's network in both",
            config.ip_number,
            station.address,
            ("address",),
        )


def _corrections(config: EthernetConfig, station: Station) -> Iterator[Finding]:
    try:
        fields = correction_fields(config, station.axes)
    except EthernetConfigError as error:
        yield Finding("error", "RECEIVE", _without_source(error, config))
        return
    wanted = [fields[axis] for axis in station.axes.axes]
    for correction in wanted:
        if not correction.element.hold_on:
            yield Finding(
                "error",
                f"RECEIVE/{correction.element.tag}",
                "HOLDON is 0: a reply that comes late lets the axis jump back to where RSI was started; write 1",
                0,
                1,
            )
    # one object takes A1 … A6, then E1 … E6, as inputs 1 to 12
    in_order = [(axis, fields[axis].element.channel or 0) for axis in sorted(station.axes.axes)]
    channels = [channel for _, channel in in_order]
    if channels != sorted(channels):
        listed = ", ".join(f"{axis} {channel}" for axis, channel in in_order)
        yield Finding(
            "warning",
            "RECEIVE",
            f"INDX of the corrections is not in the order of the axes ({listed}): links made in that order would move "
            "the wrong axes; number them in order, or see that each link leads to its own axis",
            listed,
        )


def _measurements(config: EthernetConfig, station: Station) -> Iterator[Finding]:
    sent = {element.internal for element in config.send}
    arm = any(axis[0] == "A" for axis in station.axes.axes)
    external = any(axis[0] == "E" for axis in station.axes.axes)
    for asked, measured, programmed in ((arm, "AIPos", "ASPos"), (external, "EIPos", "ESPos")):
        if not asked:
            continue
        if measured not in sent:
            yield Finding(
                "error",
                f"SEND/DEF_{measured}",
                "is missing: the positions of the axes are unknown; add it with TYPE DOUBLE and INDX INTERNAL",
            )
        if programmed not in sent:
            yield Finding(
                "warning",
                f"SEND/DEF_{programmed}",
                "is missing: without it the Robot Server cannot tell a new session from a continuing one, and the "
                "robot could jump by its whole correction; add it with TYPE DOUBLE and INDX INTERNAL",
            )
    if "Delay" not in sent:
        yield Finding(
            "warning",
            "SEND/DEF_Delay",
            "is missing: late replies are not reported, so a lost setpoint counts as taken; "
            "add it with TYPE LONG and INDX INTERNAL",
        )


def _signals(config: EthernetConfig, station: Station) -> Iterator[Finding]:
    for direction, kind, elements, tags in (
        ("SEND", "inputs", config.send, station.inputs),
        ("RECEIVE", "outputs", config.receive, station.outputs),
    ):
        known = [element.tag for element in elements if element.type is ElementType.BOOL]
        for name, tag in tags.items():
            if tag not in known:
                yield _no_signal(direction, tag, known, (kind, name))
        for tag in {tag for tag in tags.values() if list(tags.values()).count(tag) > 1}:
            names = [name for name in tags if tags[name] == tag]
            yield Finding(
                "error",
                f"{direction}/{tag}",
                f"stands for {' and '.join(names)}; give each a signal of its own",
                tag,
                field=(kind, names[-1]),
            )


def _stop(config: EthernetConfig, station: Station) -> Iterator[Finding]:
    if station.stop is None:
        yield Finding(
            "warning",
            "RECEIVE/Stop",
            "no signal that ends the motion on the KRC's side is named: the PC can only hold still or fall silent; add "
            "a BOOL such as Stop, link it to the object that ends the motion, and name it as driver.stop",
        )
        return
    bools = {element.tag: element for element in config.receive if element.type is ElementType.BOOL}
    if (element := bools.get(station.stop)) is None:
        yield _no_signal("RECEIVE", station.stop, list(bools), ("stop",))
    elif not element.hold_on:
        yield Finding(
            "warning",
            f"RECEIVE/{element.tag}",
            "HOLDON is 0: a stop is taken back by the first late reply; write 1",
            0,
            1,
            ("stop",),
        )
    for name, tag in station.outputs.items():
        if tag == station.stop:
            yield Finding(
                "error",
                f"RECEIVE/{tag}",
                f"ends the motion and is the output {name} as well; give each a signal of its own",
                tag,
                field=("stop",),
            )


def _no_signal(direction: str, tag: str, known: list[str], field: tuple[str, ...]) -> Finding:
    return Finding(
        "error",
        f"{direction}/{tag}",
        f"no BOOL has that TAG, and the cell names it for {field[-1]}; there are {', '.join(known) or 'none'}; add "
        "an ELEMENT with that TAG and TYPE BOOL",
        tag,
        ", ".join(known) or None,
        field,
    )


def _without_source(error: EthernetConfigError, config: EthernetConfig) -> str:
    return str(error).removeprefix(f"{config.source}: ")


def _reaches(ip_number: str, address: str) -> bool:
    """Whether a datagram that another machine sends to `ip_number` can arrive at a listener on `address`."""
    if is_any(address):
        return not is_loopback(ip_number) and not is_any(ip_number)
    return ip_number == address or (_ip(ip_number) is not None and _ip(ip_number) == _ip(address))


def _ip(address: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(address)
    except ValueError:
        return None
