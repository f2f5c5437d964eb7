"""Contents of the files of one robot's KRC, in the KRC's own terms: degrees, millimetres, axes and channels."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import PurePath

from deltaq_cell.check_description import KRC_CYCLES_S
from deltaq_cell.description import CellDescription, RobotDescription, RsiDescription
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.rsi import AxisMap
from deltaq_protocol.rsi.axes import ARM_AXES, KrcGeneration
from deltaq_protocol.rsi.judge import is_any

RSI_OF = {"krc2": (2,), "krc4": (3, 4)}
"""Generations of RSI by generation of the KRC, the usual one first; 4 stands for all that came after it."""
PRECISION = 4
"""Decimals that the KRC sends: a tenth of a thousandth of a degree."""
TIMEOUT_CYCLES = 100
"""Replies that may come late before RSI stops, as published contexts have it; the maker's default is 10."""
MONITOR_MARGIN = 1.0
"""Distance of the monitor's bound from the correction limit [deg or mm]: a clipped correction must not stop RSI as
well.
"""
LONGEST_NAME = 24
"""Characters of a name in KRL."""


def written(value: float) -> str:
    """A number as KRL and RSI Visual write it."""
    return f"{value:.4f}".rstrip("0").rstrip(".") if round(value, 4) else "0"


class KrcFilesError(DeltaqError):
    """Files of a KRC that cannot be written as asked."""


class Start(StrEnum):
    """Position of the robot at the start of RSI; corrections count from it."""

    HOME = "home"
    HERE = "here"


@dataclass(frozen=True)
class Correction:
    """How far one axis may be corrected.

    Attributes:
        axis: `A1` … `E6`.
        channel: output of the KRC's ETHERNET object, the INDX of `*_ethernet.xml`.
        unit: `deg` or `mm`.
        home: the cell's home of the axis.
        lower: least total correction, below 0.
        upper: greatest total correction.
    """

    axis: str
    channel: int
    unit: str
    home: float
    lower: float
    upper: float

    @property
    def tag(self) -> str:
        """TAG of the correction."""
        return f"{'AK' if self.axis in ARM_AXES else 'EK'}.{self.axis}"

    @property
    def number(self) -> int:
        """The input of the axis correction object of a KR C2 and of RSI 3: 1 to 6 for A1 to A6, from 7 on for E1."""
        return int(self.axis[1]) + (0 if self.axis in ARM_AXES else len(ARM_AXES))

    @property
    def monitored(self) -> float:
        """Total correction at which RSI stops."""
        return round(max(-self.lower, self.upper) + MONITOR_MARGIN, 4)


@dataclass(frozen=True)
class Signal:
    """A digital signal.

    Attributes:
        name: the cell's name of it.
        tag: its TAG.
        channel: its INDX.
        digital: number of the KRC's own $IN or $OUT; None if it was not given.
    """

    name: str
    tag: str
    channel: int
    digital: int | None = None


@dataclass(frozen=True)
class KrcPlan:
    """The contents of the files of one robot's KRC.

    Attributes:
        cell: the cell's name.
        robot: the robot's name.
        krc: generation of the controller.
        rsi: generation of RSI.
        cycle_ms: its cycle.
        address: the PC's, as the KRC sees it.
        port: the PC's UDP port.
        ethernet_xml: name of the `*_ethernet.xml`.
        start: position at the start of RSI.
        corrections: of A1 to A6, then of the external axes.
        inputs: from the KRC.
        outputs: to the KRC.
        stop: ends the motion; None if the cell names none.
    """

    cell: str
    robot: str
    krc: KrcGeneration
    rsi: int
    cycle_ms: int
    address: str
    port: int
    ethernet_xml: str
    start: Start
    corrections: tuple[Correction, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    stop: Signal | None

    @property
    def program(self) -> str:
        """Name of the KRL program and of the context."""
        return f"deltaq_{self.robot.replace('-', '_')}"

    @property
    def external(self) -> tuple[Correction, ...]:
        """Corrections of the external axes."""
        return tuple(one for one in self.corrections if one.axis not in ARM_AXES)

    @property
    def arm(self) -> tuple[Correction, ...]:
        """Corrections of A1 to A6."""
        return tuple(one for one in self.corrections if one.axis in ARM_AXES)


def plan_for(
    cell: CellDescription,
    robot: str,
    *,
    start: Start = Start.HOME,
    rsi: int | None = None,
    address: str | None = None,
    limit_deg: float | None = None,
    limit_mm: float | None = None,
    digital: Mapping[str, int] | None = None,
) -> KrcPlan:
    """Plan the files of a robot's KRC.

    Started at home, corrections are limited to the range from there to the cell's own joint limits. Started where
    the robot happens to stand, that range is not known in advance: then the limit is the joint's whole range,
    either way, and only the KRC's software limit switches bound the motion.

    Args:
        cell: the cell.
        robot: name of the robot.
        start: position at the start of RSI.
        rsi: generation of RSI; the usual one of the controller if None.
        address: the PC's as the KRC sees it; the cell's `driver.address` if None.
        limit_deg: no rotating axis may be corrected by more, either way; for the first motion.
        limit_mm: the same for linear axes.
        digital: per digital input or output of the robot the number of the KRC's $IN or $OUT.

    Raises:
        KrcFilesError: the robot has no KRC, or a requested option is impossible.
        EthernetConfigError: a joint is no axis of a KRC.
    """
    description = cell.robots[robot]
    driver = description.driver
    if not isinstance(driver, RsiDescription):
        raise KrcFilesError(
            f"robot {robot} of cell {cell.cell} has no KRC: its driver is {driver.kind}, not rsi"
        )
    axes = AxisMap.of(description.joint_names, description.units, driver.krc)
    if missing := [axis for axis in ARM_AXES if axis not in axes.axes]:
        raise KrcFilesError(f"robot {robot} has no {', '.join(missing)}: a KRC's robot has A1 to A6")
    corrections = _corrections(description, axes, start, limit_deg, limit_mm)
    digital = _known(digital or {}, {**driver.inputs, **driver.outputs}, robot)
    after = corrections[-1].channel + 1
    inputs = _signals(driver.inputs, 1, digital)
    outputs = _signals(driver.outputs, after, digital)
    stop = None if driver.stop is None else Signal("stop", driver.stop, after + len(outputs))
    plan = KrcPlan(
        cell.cell,
        robot,
        driver.krc,
        _generation(driver.krc, rsi),
        _cycle_ms(cell, driver.krc),
        _address(address or driver.address, robot),
        driver.port,
        PurePath(driver.ethernet_xml).name,
        start,
        corrections,
        inputs,
        outputs,
        stop,
    )
    if len(plan.program) > LONGEST_NAME:
        raise KrcFilesError(
            f"{plan.program} has {len(plan.program)} characters, a name in KRL at most {LONGEST_NAME}: give the robot "
            "a shorter name"
        )
    return plan


def _corrections(
    robot: RobotDescription, axes: AxisMap, start: Start, limit_deg: float | None, limit_mm: float | None
) -> tuple[Correction, ...]:
    """Home and the range of corrections of each axis, in the order of a KRC."""
    scale = axes.commanded
    home, lower, upper = robot.home * scale, robot.lower * scale, robot.upper * scale
    corrections = []
    for axis, unit, at, low, high in zip(axes.axes, axes.units, home, lower, upper, strict=True):
        least, most = (low - at, high - at) if start is Start.HOME else (low - high, high - low)
        bound = limit_deg if unit == "rad" else limit_mm
        if bound is not None:
            least, most = max(least, -bound), min(most, bound)
        number = int(axis[1]) + (0 if axis in ARM_AXES else len(ARM_AXES))
        name = "deg" if unit == "rad" else "mm"
        corrections.append(
            Correction(axis, number, name, *(round(float(value), 4) for value in (at, least, most)))
        )
    return tuple(sorted(corrections, key=lambda one: one.number))


def _signals(tags: Mapping[str, str], first: int, digital: Mapping[str, int]) -> tuple[Signal, ...]:
    return tuple(
        Signal(name, tag, number, digital.get(name)) for number, (name, tag) in enumerate(tags.items(), first)
    )


def _known(digital: Mapping[str, int], tags: Mapping[str, str], robot: str) -> Mapping[str, int]:
    for name, number in digital.items():
        if name not in tags:
            raise KrcFilesError(
                f"robot {robot} has no digital signal {name!r}; it has {', '.join(tags) or 'none'}"
            )
        if not 1 <= number <= 4096:
            raise KrcFilesError(f"{name} is number {number}; a KRC has $IN and $OUT 1 to 4096")
    return digital


def _generation(krc: KrcGeneration, asked: int | None) -> int:
    allowed = RSI_OF[krc]
    if asked is None:
        return allowed[0]
    if asked not in allowed:
        raise KrcFilesError(
            f"RSI {asked} does not run on a {krc}; allowed is {' or '.join(map(str, allowed))}"
        )
    return asked


def _cycle_ms(cell: CellDescription, krc: KrcGeneration) -> int:
    for cycle_s in KRC_CYCLES_S[krc]:
        if abs(cell.cycle_s - cycle_s) < 1e-9:
            return round(cycle_s * 1000)
    allowed = " or ".join(f"{cycle_s * 1000:g}" for cycle_s in KRC_CYCLES_S[krc])
    raise KrcFilesError(
        f"cycle_s is {cell.cycle_s:g}: a {krc} runs at {allowed} ms; change cycle_s or driver.krc"
    )


def _address(address: str, robot: str) -> str:
    if is_any(address):
        raise KrcFilesError(
            f"robots.{robot}.driver.address is {address!r}, which is no address that a KRC can send to; give the "
            "PC's own with --address"
        )
    return address


_RSI = {
    2: "RSI 2.x with Ethernet RSI XML on a KR C2",
    3: "RSI 3.x on a KR C4",
    4: "RSI 4.x and later on a KR C4 or KR C5",
}


def written_for(plan: KrcPlan) -> str:
    """The controller that the files are for."""
    return _RSI[plan.rsi]


def xml_comment(lines: list[str]) -> str:
    """The lines as a comment in XML, which has no place for two hyphens in a row."""
    return "<!-- " + "\n     ".join(lines).replace("--", "- -") + " -->\n"


def header(plan: KrcPlan, what: str) -> list[str]:
    """Lines of a comment at the head of a file; `what` names the file's purpose."""
    start = {
        Start.HOME: "RSI starts at the cell's home, to which the program moves first.",
        Start.HERE: "RSI starts where the robot stands; the software limit switches bound the motion.",
    }[plan.start]
    return [
        f"{what} for the robot {plan.robot} of the cell {plan.cell}, written by `deltaq krc files`.",
        f"For {written_for(plan)}, {plan.cycle_ms} ms. The telegrams are checked against",
        "the emulator; nothing here has been tried on a real controller of that version: read it, and start in T1.",
        start,
    ]
